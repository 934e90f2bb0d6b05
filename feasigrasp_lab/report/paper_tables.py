"""Tables of the paper (arXiv 2311.02576), for comparison."""

#: Table I: mean and standard deviation of the static grasps that succeeded, over objects [%].
#: Source: paper: Table I.
TABLE_1 = (90.00, 11.49)
#: The same for its sampler alone, with the post-filter, and with the reachability filter too [%].
#: Source: paper: Table I.
TABLE_1_ABLATION = (77.6, 88.6, 90.0)

#: Metric of a run -> heading, digits, and whether more is better; the columns of Table II.
TABLE_2_COLUMNS = {
    "self_collision_percent": ("self-collision [%]", 2, False),
    "joint_limit_violation_percent": ("joint limits violated [%]", 2, False),
    "manipulability_mean": ("manipulability", 4, True),
    "gripper_object_distance_cm_mean": ("gripper-object distance [cm]", 2, False),
}

#: Trajectory -> method -> (mean, standard deviation) of every column, over five runs.
TABLE_2: dict[str, dict[str, tuple[tuple[float, float], ...]]] = {
    "Circular": {
        "joint space": ((1.08, 0.57), (57.06, 6.52), (0.0936, 0.0017), (16.65, 0.96)),
        "task space": ((6.72, 5.55), (89.64, 0.74), (0.0729, 0.0022), (3.31, 0.25)),
        "grasp diffusion": ((38.14, 11.37), (95.47, 0.04), (0.0766, 0.0025), (17.63, 0.79)),
    },
    "Linear": {
        "joint space": ((0.00, 0.00), (55.49, 5.34), (0.0887, 0.0052), (6.44, 0.24)),
        "task space": ((3.84, 2.12), (62.90, 30.58), (0.0785, 0.0076), (2.70, 0.19)),
        "grasp diffusion": ((5.60, 0.77), (86.91, 0.89), (0.0942, 0.0035), (16.12, 0.55)),
    },
    "Sinusoidal": {
        "joint space": ((0.00, 0.00), (55.64, 3.82), (0.0884, 0.0021), (12.47, 0.45)),
        "task space": ((1.03, 1.97), (91.63, 5.63), (0.0847, 0.0033), (7.10, 0.77)),
        "grasp diffusion": ((28.88, 3.99), (89.36, 1.17), (0.0754, 0.0032), (14.85, 1.36)),
    },
}

#: Components of the mixture -> frequency of the task-space controller [Hz]. Source: paper: Table
#: III.
TABLE_3_TASK = dict(
    enumerate((106.6, 99.4, 95.7, 90.2, 88.6, 85.2, 83.1, 81.1, 79.4, 78.2), start=1)
)
#: Samples of the Gaussian process -> frequency of the joint-space controller [Hz].
TABLE_3_JOINT = {
    10: 22.4, 20: 18.3, 30: 16.7, 40: 17.2, 50: 16.0,
    60: 15.1, 70: 15.8, 80: 14.8, 90: 14.1, 100: 13.9,
}  # fmt: skip
