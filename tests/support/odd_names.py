"""Names that an MJCF may give its axes, and that file formats cannot all hold as they are."""

from xml.sax.saxutils import quoteattr

import mujoco

from support.many_axes import rail_model

ODD_NAMES = (
    "Achse_ü", "轴", "軸", "x 1", "x_1", "x_u20_1", "$end", "time", "host", "a/b", "a.b", "../c", "1", "say \"'<b>\\", "a=b", "a,b",
    "self", "drop_untyped_nones",
)  # fmt: skip


def odd_model(names: tuple[str, ...] = ODD_NAMES) -> mujoco.MjSpec:
    """Build a model of slides without switches, an axis of each name."""
    xml = rail_model(len(names)).to_xml()
    for k, name in enumerate(names):
        for attribute in ("name", "joint"):
            xml = xml.replace(f'{attribute}="a{k}"', f"{attribute}={quoteattr(name)}")
        xml = xml.replace(f'name="a{k}_unfitted"', f"name={quoteattr(name + '_unfitted')}")
    return mujoco.MjSpec.from_string(xml)
