"""Many runs: plans, isolated processes, summaries, probes and roll-outs."""
