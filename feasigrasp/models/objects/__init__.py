"""Objects: their meshes, motions, and where they will be."""
