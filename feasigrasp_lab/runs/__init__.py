"""Many runs: plans, processes of their own, summaries, probes and roll-outs."""
