"""The method of "Towards Feasible Dynamic Grasping" (arXiv 2311.02576), to compare with.

Its laws as printed and corrected, IK flow, density of reachable poses, and grasp network.
"""
