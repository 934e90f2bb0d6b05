"""Bodies that are only seen: put into what cameras and viewers show, and moved there."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydrake.geometry import (
    FrameId,
    FramePoseVector,
    GeometryFrame,
    GeometryInstance,
    MakePhongIllustrationProperties,
    Mesh,
    PerceptionProperties,
    RenderLabel,
    Rgba,
    SceneGraph,
)
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, DiagramBuilder, EventStatus, LeafSystem

from feasigrasp.models.objects.company import Companion
from feasigrasp.models.objects.mesh import write_obj
from feasigrasp.systems.ports import declare_output

#: How exactly the time is known at which the object is let go [s].
_PERIOD = 0.01


class Company(LeafSystem):
    """Where bodies are that are only seen, in a scene graph.

    .. pydrake_system::

        name: Company
        input_ports:
        - hold
        output_ports:
        - poses

    ``hold`` is 1 while the object is carried and 0 once it is let go; ``poses`` is a
    ``FramePoseVector`` for the scene graph.
    """

    def __init__(self, bodies: Sequence[Companion], frames: Sequence[FrameId]) -> None:
        """Moves bodies, each with its frame of the scene graph."""
        super().__init__()
        self._bodies = list(zip(bodies, frames, strict=True))
        self._hold = self.DeclareVectorInputPort("hold", 1)
        # When the object was let go; infinite before.
        self._let_go = self.DeclareDiscreteState([np.inf])
        self.DeclarePeriodicDiscreteUpdateEvent(_PERIOD, 0.0, self._remember)
        declare_output(self, "poses", self._calc, model=FramePoseVector())

    def _remember(self, context: Context, state) -> EventStatus:
        known = np.isfinite(context.get_discrete_state_vector().value()[0])
        if known or self._hold.Eval(context)[0] > 0.5:
            return EventStatus.DidNothing()
        state.get_mutable_vector().SetAtIndex(0, context.get_time())
        return EventStatus.Succeeded()

    def _calc(self, context: Context) -> FramePoseVector:
        time = context.get_time()
        since = max(time - context.get_discrete_state_vector().value()[0], 0.0)
        poses = FramePoseVector()
        for body, frame in self._bodies:
            poses.set_value(frame, RigidTransform(body.pose(time, since)))
        return poses


def add_company(
    builder: DiagramBuilder,
    scene_graph: SceneGraph,
    bodies: Sequence[Companion],
    *,
    name: str,
    directory: str | Path,
    first_label: int,
) -> Company:
    """Puts bodies into a scene graph, and adds the system that moves them; ``hold`` is left open.

    They can be seen by cameras and viewers, and are no obstacle to anything.

    Args:
        builder: The builder that holds the scene graph.
        scene_graph: Where they are shown.
        bodies: The bodies.
        name: Of the system.
        directory: Existing folder for their meshes; renderers read them late.
        first_label: Label of the first one in label images; the next ones count up.
    """
    source = scene_graph.RegisterSource(name)
    frames = []
    for label, body in enumerate(bodies, start=first_label):
        path = Path(directory) / f"{body.name}.obj"
        write_obj(path, np.asarray(body.mesh.vertices), np.asarray(body.mesh.faces))
        frame = scene_graph.RegisterFrame(source, GeometryFrame(body.name))
        geometry = GeometryInstance(RigidTransform(), Mesh(str(path)), body.name)
        geometry.set_illustration_properties(
            MakePhongIllustrationProperties(np.asarray(body.color))
        )
        geometry.set_perception_properties(_seen(body.color, label))
        scene_graph.RegisterGeometry(source, frame, geometry)
        frames.append(frame)
    company = builder.AddNamedSystem(name, Company(bodies, frames))
    builder.Connect(company.get_output_port(), scene_graph.get_source_pose_port(source))
    return company


def _seen(color: Sequence[float], label: int) -> PerceptionProperties:
    properties = PerceptionProperties()
    properties.AddProperty("phong", "diffuse", Rgba(*color))
    properties.AddProperty("label", "id", RenderLabel(label))
    return properties
