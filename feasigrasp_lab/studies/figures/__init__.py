"""The commands that draw what a stage does, and measure what they draw."""
