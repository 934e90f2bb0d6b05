"""Which pixels of a depth image show the object, by depth alone."""
