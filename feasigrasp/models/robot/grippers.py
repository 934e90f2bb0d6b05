"""Other hands than the default one, as examples of how to describe one's own.

A hand is six lengths and two boxes; the sampler, the filter and the network's view of the room for
a hand take them from there, so nothing is trained anew.
"""

from feasigrasp.models.robot.gripper import ParallelGripper

#: A hand like the Schunk WSG 50 with 110 mm stroke. Lengths as in Drake's description of it, made
#: after the maker's drawing: body 146 x 72.5 x 50 mm, fingers 12 x 82 x 20 mm that start at its
#: front face, pads on the last 20 mm of each. The flange is the back of the body. The camera sits
#: beside the body as far out as on the default hand.
WSG_50 = ParallelGripper(
    max_opening=0.110,
    finger_thickness=0.012,
    finger_width=0.020,
    tip=0.010,
    heel=-0.072,
    palm_size=(0.146, 0.050, 0.0725),
    tool_offset=0.1445,
    camera_center=(0.0, 0.0705, -0.127),
)
