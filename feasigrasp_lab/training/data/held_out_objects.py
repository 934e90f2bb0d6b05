"""Held-out objects and seeds."""

from pathlib import Path

from tqdm import tqdm

from feasigrasp.models.objects.rigid_object import RigidObject, load_object, write_mesh
from feasigrasp.outputs import write_json
from feasigrasp_lab.results.arguments import names, select_objects
from feasigrasp_lab.training.data.household_shapes import HELD_OUT, make_shape

#: Part of ``--objects``: generated shapes of the families that are held out.
GENERATED = "held-out"
#: Default of ``--objects``; the folder is left out where it is missing.
DEFAULT_OBJECTS = f"{GENERATED},../shared/data/ycb"
#: Seeds from here on are used by no training; its validation takes those from 0 on. Source:
#: definition.
FIRST_SEED = 10_000_000
#: Seeds from here on are used by nothing but `write_test_objects`; `feasigrasp fit certainty` takes
#: some between the two. Source: definition.
FIRST_TEST_SEED = 30_000_000


def held_out_objects(selection: str, count: int, seed: int) -> dict[str, str]:
    """What `make_object` makes of objects that ``--objects`` asks for.

    Args:
        selection: ``held-out``, folders of meshes, names or mesh files, separated by commas.
        count: Number of generated shapes.
        seed: Of the generated shapes.
    """
    found: dict[str, str] = {}
    for part in names(selection):
        if part == GENERATED:
            for index in range(count):
                family = HELD_OUT[index % len(HELD_OUT)]
                shape = f"{family}/{FIRST_SEED + 1000 * seed + index // len(HELD_OUT)}"
                found[shape.replace("/", "_")] = f"{GENERATED}/{shape}"
        elif part in DEFAULT_OBJECTS and not Path(part).is_dir():
            print(f"{part} is not there: its objects are left out")
        else:
            found |= select_objects(part)
    return found


def make_object(what: str) -> RigidObject:
    """The object of a value of `held_out_objects`."""
    if what.startswith(f"{GENERATED}/"):
        _, family, seed = what.split("/")
        return make_shape(family, int(seed))
    return load_object(what)


def write_test_objects(folder: Path, count: int) -> dict[str, str]:
    """Makes the objects of the test split: shapes of the held-out families, one after the other.

    What the generator draws is taken as it comes, also what is too wide for a hand everywhere. A
    mesh that is there already is kept.

    Args:
        folder: Where the meshes go, and ``objects.json`` with their masses.
        count: Number of shapes.

    Returns:
        Mesh files by name.
    """
    catalogue = []
    for index in tqdm(range(count), desc="objects", leave=False):
        family, number = HELD_OUT[index % len(HELD_OUT)], index // len(HELD_OUT)
        made = make_shape(family, FIRST_TEST_SEED + number)
        name = f"test_{family}_{number}"
        path = folder / f"{name}.obj"
        if not path.exists():
            folder.mkdir(parents=True, exist_ok=True)
            write_mesh(made, path)
        entry = {"name": name, "mesh": path.name, "mass_kg": made.mass, "color": made.color}
        catalogue.append(entry)
    write_json({"objects": catalogue}, folder / "objects.json")
    return {str(entry["name"]): str(folder / str(entry["mesh"])) for entry in catalogue}
