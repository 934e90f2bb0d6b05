"""Makes the built-in objects: ``python models/objects/make_objects.py [--sheet PNG]``.

Writes ``<name>.obj`` (metres, z up, closed, with vertex normals) and ``objects.json`` beside this
script. The objects are modelled here from scratch in the size range of the YCB set; no data of
others goes in.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import trimesh
from catalogue import OBJECTS

from feasigrasp.models.objects.mesh import obj_text, read_solid
from feasigrasp.outputs import write_text

HERE = Path(__file__).resolve().parent


def write_objects(folder: Path) -> None:
    """Writes every mesh and the catalogue into a folder."""
    entries = []
    for item in OBJECTS:
        mesh = item.make().to_mesh64()
        path = folder / f"{item.name}.obj"
        surface = trimesh.Trimesh(mesh.vert_properties, mesh.tri_verts, process=False)
        write_text(path, obj_text(surface))
        written, notes = read_solid(path)  # what users will read, checked as they will
        if notes or not 500 <= len(written.faces) <= 3500:
            raise RuntimeError(f"{item.name}: {len(written.faces)} faces, {notes}")
        entries.append(
            {
                "name": item.name,
                "mesh": path.name,
                "mass_kg": item.mass,
                "density_kgm3": round(item.mass / float(written.volume), 1),
                "extents_m": [round(float(e), 4) for e in written.extents],
                "color": [*item.color, 1.0],
                **({} if item.material == "matt" else {"material": item.material}),
                "description": item.description,
            }
        )
    content = {
        "description": "Household-like objects made by make_objects.py",
        "units": "m, kg",
        "objects": entries,
    }
    (folder / "objects.json").write_text(json.dumps(content, indent=1) + "\n")


def main() -> None:
    """Writes the objects and, if asked, a picture of them all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=HERE, help="folder to write into")
    parser.add_argument("--sheet", type=Path, help="also draw all objects into this PNG (Drake)")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    write_objects(args.out)
    if args.sheet:
        from contact_sheet import draw_sheet

        draw_sheet(args.out, args.sheet)


if __name__ == "__main__":
    main()
