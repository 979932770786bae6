"""The command `stage example`: a copy of an example, to begin with."""

from __future__ import annotations

import argparse
from pathlib import Path

from stage.cli.facts import tell, wrote


def run(args: argparse.Namespace) -> int:
    """Copy one, or list them all."""
    from stage.support import examples

    if args.name is None:
        titles = {name: _titled(name) for name in examples.PLACES}
        tell(args, titles)
        wide = max(map(len, titles))
        print("\n".join(f"{name:{wide}}  {title}" for name, title in titles.items()))
        return 0
    name = args.name.removesuffix(".py")
    made = examples.copy(name, Path(args.to), args.force)
    wrote(args, made, _next(made) + _missing(name))
    return 0


def _titled(name: str) -> str:
    """What it shows, and what it needs, in a line."""
    from stage.support import examples

    needs = examples.EXTRAS.get(name)
    return examples.title(name) + (f" It {needs}." if needs else "")


def _missing(name: str) -> str:
    """What has to be installed for it first."""
    from stage.support import examples
    from stage.support.extras import has

    needs = examples.EXTRAS.get(name)
    return f"; it {needs}" if needs and not has(needs.library) else ""


def _next(made: Path) -> str:
    """What one types now."""
    if made.suffix == ".py":
        return f"run it with: python {made}"
    if made.suffix == ".ipynb":
        return f"open it with: jupyter lab {made}"
    page = next((p for p in ("README.md", "pyproject.toml") if (made / p).exists()), None)
    return f"a folder; begin with {made / page}" if page else "a folder"
