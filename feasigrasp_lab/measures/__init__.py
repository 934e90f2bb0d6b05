"""Error measures of shapes, grasps and scores."""
