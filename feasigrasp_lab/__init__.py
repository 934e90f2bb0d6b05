"""What measures feasigrasp, trains its networks and compares it with others; nothing that runs."""
