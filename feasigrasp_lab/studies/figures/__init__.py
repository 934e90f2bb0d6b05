"""Commands that draw the result of a stage, and measure it."""
