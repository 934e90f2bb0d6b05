"""Pictures of the arm's capability."""
