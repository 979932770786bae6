"""The command `stage example`: a copy of an example, to begin with."""

from __future__ import annotations

import argparse
from pathlib import Path

from stage.cli.facts import tell, wrote


def run(args: argparse.Namespace) -> int:
    """Copy one, or list them all."""
    from stage import examples

    if args.name is None:
        titles = {name: examples.title(name) for name in examples.PLACES}
        tell(args, titles)
        wide = max(map(len, titles))
        print("\n".join(f"{name:{wide}}  {title}" for name, title in titles.items()))
        return 0
    name = args.name.removesuffix(".py")
    made = examples.copy(name, Path(args.to), args.force)
    wrote(args, made, _next(made))
    return 0


def _next(made: Path) -> str:
    """What one types now."""
    if made.suffix == ".py":
        return f"run it with: python {made}"
    if made.suffix == ".ipynb":
        return f"open it with: jupyter lab {made}"
    page = next((p for p in ("README.md", "pyproject.toml") if (made / p).exists()), None)
    return f"a folder; begin with {made / page}" if page else "a folder"
