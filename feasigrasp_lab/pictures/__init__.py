"""Pictures of the arm's workspace."""
