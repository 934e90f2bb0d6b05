"""Training and fitting of what the package ships."""
