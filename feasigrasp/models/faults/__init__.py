"""What can go wrong while a run goes on: cameras, masks, poses, the object, the command."""
