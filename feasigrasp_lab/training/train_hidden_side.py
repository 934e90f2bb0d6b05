"""``feasigrasp train hidden-side``: train the network that completes the unobserved side.

First it makes pictures of household shapes, in shards that are kept: a shape is looked at from one
to three random directions by the noisy depth camera, the distance field is fitted, and rays cast
from behind towards a camera give the end of the object behind every pixel of its picture. Then it
trains `HiddenSideNetwork` on them. Whole families are held out and validate;
start the same command again to resume.
"""

import argparse
import itertools
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from feasigrasp.models.arrays import Array
from feasigrasp.models.clouds.view_image import SIDE, ViewImage
from feasigrasp.models.shape.completion import ROUGH_POINTS, complete_shape
from feasigrasp.models.shape.hidden_side import (
    CHANNELS,
    ESTIMATED,
    FEATURES,
    LEAST_SPREAD,
    TYPICAL_SIZE,
    HiddenSide,
    features,
    picture_scale,
)
from feasigrasp.runs.results.arguments import positive
from feasigrasp_lab.networks import network_arrays
from feasigrasp_lab.results.arguments import add_run_arguments
from feasigrasp_lab.results.finished import make_shards, read_shards, write_arrays
from feasigrasp_lab.training.data.household_shapes import HELD_OUT, make_shape, shape_of
from feasigrasp_lab.training.data.views import ViewedObject, fused, turning_views
from feasigrasp_lab.training.loop import (
    TrainingRun,
    add_loop_arguments,
    rows_of_step,
    without_denormals,
)


class _Block(nn.Sequential):
    """Two convolutions."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, 3, padding=1),
            nn.SiLU(),
            nn.Conv2d(outputs, outputs, 3, padding=1),
            nn.SiLU(),
        )


class HiddenSideNetwork(nn.Module):
    """The U-Net of `feasigrasp.models.shape.hidden_side` in torch.

    It corrects the thickness that is estimated without it. Pictures (b, FEATURES, s, s) become
    medians and scales of Laplace distributions, (b, s, s) each, in units of the picture's scale;
    s is a multiple of 8. Blocks of 2 x 2 pixels are looked at together: what lies behind them
    hardly differs.
    """

    def __init__(self, channels: tuple[int, ...] = CHANNELS) -> None:
        super().__init__()
        self.channels = channels
        inputs = (4 * FEATURES, *channels[:-1])
        self.down = nn.ModuleList(_Block(a, b) for a, b in zip(inputs, channels, strict=True))
        self.up = nn.ModuleList(_Block(a + b, a) for a, b in itertools.pairwise(channels))
        self.head = nn.Conv2d(channels[0], 2, 1)
        nn.init.zeros_(self.head.weight)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        x = functional.pixel_unshuffle(pictures, 2).contiguous(memory_format=torch.channels_last)
        skipped: list[Tensor] = []
        for block in self.down:
            x = block(functional.avg_pool2d(x, 2) if skipped else x)
            skipped.append(x)
        for level in reversed(range(len(self.up))):
            larger = functional.interpolate(x, scale_factor=2, mode="nearest")
            x = self.up[level](torch.cat([skipped[level], larger], dim=1))
        answers = functional.interpolate(self.head(x), scale_factor=2, mode="bilinear")
        change, spread = answers.unbind(dim=1)
        return pictures[:, ESTIMATED] + change, functional.softplus(spread) + LEAST_SPREAD


def export(network: HiddenSideNetwork) -> HiddenSide:
    """The network without torch, as it is used and saved."""
    return HiddenSide(network.channels, network_arrays(network))


Pictures = tuple[NDArray[np.float16], NDArray[np.float16]]

#: Objects of a shard. Source: numerical.
SHARD = 64


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the arguments of the command."""
    add_run_arguments(parser, out="out/train_hidden_side")
    parser.add_argument(
        "--objects", type=positive, default=2048, help="Number of household shapes."
    )
    parser.add_argument("--views", type=positive, default=12, help="Depth images of each shape.")
    parser.add_argument("--steps", type=positive, default=8000, help="Number of training steps.")
    add_loop_arguments(parser, batch=32, rate=2e-3, of="pictures")
    # Steps between two lines of the curve; the last weights count as the best, so patience lasts.
    parser.set_defaults(every=200, minutes=None, patience=1)
    parser.add_argument("--quick", action="store_true", help="Train on a sample, for 1 minute.")


def true_thickness(viewed: ViewedObject, image: ViewImage) -> Array:
    """From the pictured depth to where the object ends, along z of the camera.

    Returns:
        Shape (SIDE, SIDE) [m]; NaN outside the silhouette and where a line of sight misses.
    """
    rays = image.rays()[image.mask]
    length = np.linalg.norm(rays, axis=1)
    ways = rays @ image.X_OC[:3, :3].T / length[:, None]
    # Rays start this far behind the middle of the object [m].
    far = float(image.depth[image.mask].mean()) + 1.0
    starts = image.X_OC[:3, 3] + far * ways
    back = far - viewed.surface.cast(starts, -ways)[0]
    thickness = np.full(image.mask.shape, np.nan)
    thickness[image.mask] = np.where(
        np.isfinite(back), back / length - image.depth[image.mask], np.nan
    )
    return thickness


def object_pictures(
    index: int, views: int, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """So many pictures of one object of the stream, fewer if it can hardly be seen.

    Returns:
        `features` of them, shape (n, FEATURES, SIDE, SIDE), and the true thickness in units of
        `picture_scale`, shape (n, SIDE, SIDE), NaN where there is none.
    """
    rng = np.random.default_rng([seed, index, 40])
    viewed = ViewedObject(make_shape(*shape_of(index, seed)))
    seen, truth = [], []
    for _ in range(views):
        # From how many directions an object is looked at; one of these at random.
        # It turns by so much between two views, least and most [deg].
        cameras = turning_views(rng, viewed.center, int(rng.choice((1, 1, 2, 3))), (10.0, 120.0))
        views_of = [viewed.view(X_OC, rng) for X_OC in cameras]
        # Fewer points than this are no picture.
        cloud = fused([view for view in views_of if len(view.points) >= 30])
        if not cloud.images:
            continue
        image = cloud.images[rng.integers(len(cloud.images))]
        field = complete_shape(cloud, max_points=ROUGH_POINTS, learnt=False)
        seen.append(features(image, field))
        truth.append((true_thickness(viewed, image) / picture_scale(image)).astype(np.float32))
    if not seen:
        nothing = np.zeros((0, FEATURES, SIDE, SIDE), np.float32)
        return nothing, nothing[:, 0]
    return np.stack(seen), np.stack(truth)


def _write_shard(filename: Path, number: int, *, views: int, seed: int) -> None:
    seen, truth, held = [], [], []
    for index in range(number * SHARD, (number + 1) * SHARD):
        pictures, thickness = object_pictures(index, views, seed)
        seen.append(pictures.astype(np.float16))
        truth.append(thickness.astype(np.float16))
        held.append(np.full(len(pictures), shape_of(index, seed)[0] in HELD_OUT))
    arrays = {"pictures": seen, "thickness": truth, "held_out": held}
    write_arrays(filename, {name: np.concatenate(parts) for name, parts in arrays.items()})


def read_pictures(files: list[Path]) -> tuple[Pictures, Pictures]:
    """Pictures and thickness to train on, and those that judge."""
    found = read_shards(files, ("pictures", "thickness", "held_out"))
    pictures, thickness, held = found.values()
    return (pictures[~held], thickness[~held]), (pictures[held], thickness[held])


def loss(median: Tensor, spread: Tensor, truth: Tensor) -> Tensor:
    """Negative log likelihood of a Laplace distribution, pixels without truth left out."""
    known = torch.isfinite(truth)
    error = (torch.nan_to_num(truth) - median).abs()
    return (error / spread + torch.log(2.0 * spread))[known].mean()


class Training(TrainingRun[HiddenSideNetwork]):
    """One training run; the running means of the weights are what is judged and written."""

    weights = "hidden_side.npz"
    shown = "held out {held_out_mm:.2f} mm"
    columns = (
        *("step", "minutes", "train_loss", "held_out_loss"),
        *("held_out_mm", "held_out_ratio", "believed_mm"),
    )

    def __init__(self, args: argparse.Namespace, train: Pictures, judge: Pictures) -> None:
        self.pictures, self.judge = train, judge
        identity = {
            "seed": args.seed,
            "batch": args.batch,
            "steps": args.steps,
            "pictures": len(train[0]),
            "held_out": len(judge[0]),
        }
        torch.manual_seed(args.seed)
        optimizer = torch.optim.AdamW, {"weight_decay": 1e-3}
        super().__init__(args, HiddenSideNetwork(), optimizer, identity)

    def losses(self) -> dict[str, Tensor]:
        """On pictures that are turned by quarter turns and mirrored at random."""
        seed = self.args.seed
        rows = np.sort(rows_of_step(len(self.pictures[0]), self.args.batch, seed, self.step))
        turn, mirror = np.random.default_rng([seed, self.step, 1]).integers((4, 2))
        seen, truth = (_tensor(part[rows], self.args.device) for part in self.pictures)
        seen, truth = (torch.rot90(part, int(turn), (-2, -1)) for part in (seen, truth))
        if mirror:
            seen, truth = seen.flip(-1), truth.flip(-1)
        median, spread = self.network(seen)
        return {"loss": loss(median, spread, truth)}

    def measure(self) -> dict[str, float]:
        """Figures on what is held out."""
        found: dict[str, list[float]] = {}
        for start in range(0, len(self.judge[0]), 64):
            rows = slice(start, start + 64)
            seen, truth = (_tensor(part[rows], self.args.device) for part in self.judge)
            with torch.inference_mode():
                median, spread = self.averaged(seen)
            scale = TYPICAL_SIZE * torch.exp(seen[:, 3].amin(dim=(1, 2)) + seen[:, 3].amax((1, 2)))
            error = (truth - median).abs()
            before = (truth - seen[:, ESTIMATED]).abs()
            for name, value in {
                "held_out_loss": loss(median, spread, truth),
                "held_out_mm": (1e3 * scale[:, None, None] * error).nanmean(),
                "held_out_ratio": (error / spread).nanmean(),
                "believed_mm": (1e3 * scale[:, None, None] * before).nanmean(),
            }.items():
                found.setdefault(name, []).append(float(value))
        return {name: float(np.mean(values)) for name, values in found.items()}

    def export(self) -> None:
        """Writes the running means."""
        export(self.averaged).save(self.folder / self.weights)


def _tensor(part: NDArray[np.float16], device: str) -> Tensor:
    return torch.from_numpy(part.astype(np.float32)).to(device)


@without_denormals()
def main(args: argparse.Namespace) -> int:
    """Makes the pictures, and trains or goes on with training."""
    # What ``--quick`` makes and does.
    quick_objects, quick_steps = 64, 40
    if args.quick:
        args.objects, args.steps = min(args.objects, quick_objects), min(args.steps, quick_steps)
    numbers = range(-(-args.objects // SHARD))
    files = [args.out / "pictures" / f"pictures_{number:04d}.npz" for number in numbers]
    make = partial(_write_shard, views=args.views, seed=args.seed)
    make_shards(files, make, jobs=args.jobs, desc="pictures")
    return Training(args, *read_pictures(files)).run()
