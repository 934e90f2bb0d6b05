"""Pictures of perception results."""
