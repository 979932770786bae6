"""Models whose x screw turns the other way."""

from pathlib import Path


def mirrored(folder, model="xy"):
    """The path of a shipped model in `folder`, with gear="-628.3185307" of axis x."""
    for part in (Path(__file__).parents[2] / "models").glob("*.xml"):
        (folder / part.name).write_text(part.read_text().replace('joint="x" gear="', 'joint="x" gear="-'))
    return str(folder / f"{model}.xml")
