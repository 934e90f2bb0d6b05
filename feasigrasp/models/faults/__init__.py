"""Fault models: cameras, masks, poses, the object, the command."""
