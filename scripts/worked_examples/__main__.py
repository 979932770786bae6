"""Numbers of the data sheets, compared with those of the emulated chips.

python scripts/worked_examples                                      prints them
python scripts/worked_examples --markdown docs/worked_examples.md   writes them between the page's markers
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from worked_examples.page import compute_rows, format_tables, replace_tables


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--markdown", metavar="FILE", help="write the table into this page")
    args = parser.parse_args()
    results = compute_rows()
    print(format_tables(results))
    if args.markdown:
        page = Path(args.markdown)
        page.write_text(replace_tables(page.read_text(), format_tables(results)))
    return 0 if all(example.agrees(emulated) for example, emulated in results) else 1


if __name__ == "__main__":
    sys.exit(main())
