"""What the parts of an evaluation change in a scenario: speeds, degradations, rules of a test."""
