"""Thin Drake ``LeafSystem``s and ``Diagram``s around ``feasigrasp.models``."""
