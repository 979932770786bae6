"""Write the tables of docs/diagnostics.md: the sections of the data sheets that diagnostics cite, from the lints and register maps.

python scripts/diagnostics_table.py
"""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from types import ModuleType

from stage.chips import HCTL1100, MCX312, MCX514, PCL240MS, STEPDIR
from stage.chips.hctl1100 import lint as hctl1100_lint
from stage.chips.nova import lint as nova_lint
from stage.chips.pcl240 import lint as pcl240_lint
from stage.chips.register_map import RegisterMap
from stage.chips.stepdir import lint as stepdir_lint
from stage.chips.write_diagnostics import list_rules

PAGE = Path(__file__).resolve().parents[1] / "docs" / "diagnostics.md"
BLOCK = re.compile(r"(<!-- sections: (\w+) -->\n).*?(<!-- end -->)", re.S)
FAMILIES = {
    "pcl240": (pcl240_lint, (PCL240MS.MAP,)),
    "nova": (nova_lint, (MCX514.MAP, MCX312.MAP)),
    "hctl1100": (hctl1100_lint, (HCTL1100.MAP,)),
    "stepdir": (stepdir_lint, (STEPDIR.MAP,)),
}


def make_table(lint: ModuleType, maps: tuple[RegisterMap, ...]) -> str:
    """Return a Markdown table of the sections that a family's rules, registers and words name."""
    keys, places = defaultdict(list), defaultdict(list)
    for rule in list_rules(lint):
        keys[rule.source].append(f"`{rule.key}`{' (once)' if rule.once else ''}")
    for place in dict.fromkeys((p.name, p.section) for map_ in maps for p in map_.places if p.section):
        places[place[1]].append(place[0])
    lines = ["| section | rules | registers and words |", "|---|---|---|"]
    for section in sorted({*keys, *places}):
        lines.append(f"| {section} | {', '.join(keys[section])} | {', '.join(places[section])} |")
    return "\n".join(lines)


def renew_tables(text: str) -> str:
    """Return the page with its tables computed again."""
    return BLOCK.sub(lambda m: f"{m[1]}{make_table(*FAMILIES[m[2]])}\n{m[3]}", text)


if __name__ == "__main__":
    PAGE.write_text(renew_tables(PAGE.read_text()))
    print(f"{PAGE.name} written")
