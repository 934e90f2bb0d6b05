"""Systems that inject faults between two others."""
