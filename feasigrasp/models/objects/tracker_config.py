"""What a motion-capture system is like."""

from dataclasses import dataclass


@dataclass
class TrackerConfig:
    """A motion-capture system; the default is a perfect one.

    Attributes:
        period: Time between measurements [s].
        latency: Age of a measurement when it arrives [s], rounded to periods.
        position_noise: Standard deviation [m].
        rotation_noise: Standard deviation [rad].
        dropout: Probability that a measurement is lost.
        silence: The object is lost when measurements have been missing this long [s]: its pose is
            held, nothing is grasped, and the arm waits.
        jerk: How quickly the object's acceleration is expected to change, see
            `feasigrasp.models.objects.pose_filter.Noise`: lower is smoother, higher follows sooner.
        angular_jerk: The same for its angular acceleration.
        seed: Seed of noise and losses.
    """

    period: float = 0.005
    latency: float = 0.0
    position_noise: float = 0.0
    rotation_noise: float = 0.0
    dropout: float = 0.0
    silence: float = 0.5
    jerk: float = 0.4
    angular_jerk: float = 0.3
    seed: int = 0
