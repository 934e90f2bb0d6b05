"""The look-ahead that both controllers read: strands, what they cost, and ways between them."""
