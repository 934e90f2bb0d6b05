"""Valid values of the keys of Drake's own schemas; as `feasigrasp.models.choices` for ours."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.systems.analysis import GetIntegrationSchemes

from feasigrasp.models.choices import PLACE, TURN, Span

_ROTATION = {"deg": TURN, "angle_deg": TURN, "axis": Span(-1e3, 1e3)}

#: Least and greatest value of numbers by key; ``*`` is any name.
SPANS: dict[str, Span] = {
    **{f"object.rotation.{key}": span for key, span in _ROTATION.items()},
    "simulator_config.max_step_size": Span(1e-5, 1.0, "s"),
    "simulator_config.accuracy": Span(1e-10, 0.1),
    "simulator_config.start_time": Span(0.0, 0.0, "s"),
    "simulator_config.target_realtime_rate": Span(0.0, 100.0),
    "plant_config.time_step": Span(1e-5, 0.02, "s"),
    "plant_config.penetration_allowance": Span(1e-6, 0.1, "m"),
    "plant_config.stiction_tolerance": Span(1e-7, 0.1, "m/s"),
    "plant_config.sap_near_rigid_threshold": Span(0.0, 10.0),
    "cameras.*.width": Span(16, 4096, "px"),
    "cameras.*.height": Span(16, 4096, "px"),
    "cameras.*.focal.x": Span(1.0, 1e5, "px or deg"),
    "cameras.*.focal.y": Span(1.0, 1e5, "px or deg"),
    "cameras.*.center_x": Span(0.0, 4096.0, "px"),
    "cameras.*.center_y": Span(0.0, 4096.0, "px"),
    "cameras.*.clipping_near": Span(0.001, 10.0, "m"),
    "cameras.*.clipping_far": Span(0.01, 1e4, "m"),
    "cameras.*.z_near": Span(0.001, 10.0, "m"),
    "cameras.*.z_far": Span(0.01, 100.0, "m"),
    "cameras.*.background.rgba": Span(0.0, 1.0),
    "cameras.*.fps": Span(0.1, 1000.0, "Hz"),
    "cameras.*.capture_offset": Span(0.0, 10.0, "s"),
    "cameras.*.output_delay": Span(0.0, 0.4, "s"),  # of half a second, poses are remembered
    **{
        f"cameras.*.{frame}.{key}": span
        for frame in ("X_PB", "X_BC", "X_BD")
        for key, span in (
            ("translation", PLACE),
            *((f"rotation.{key}", span) for key, span in _ROTATION.items()),
        )
    },
}

#: Words that a key may be.
WORDS: dict[str, Sequence[str]] = {
    "simulator_config.integration_scheme": GetIntegrationSchemes(),
    "plant_config.contact_model": ("point", "hydroelastic", "hydroelastic_with_fallback"),
    "plant_config.discrete_contact_approximation": ("tamsi", "sap", "similar", "lagged"),
    "plant_config.contact_surface_representation": ("triangle", "polygon"),
}
