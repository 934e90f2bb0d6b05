"""What arm and hand are: facts, kinematics, collisions."""
