"""Which pixels of the camera show the object."""
