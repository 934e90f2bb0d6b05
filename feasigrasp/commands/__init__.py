"""Commands for people: run a scenario, look at a cloud, see what there is and whether it works."""
