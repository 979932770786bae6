"""All files of recorded behaviour and their scenes."""

from importlib.util import find_spec

from recorded import (
    recorded_agents_bus,
    recorded_around_chips,
    recorded_boards,
    recorded_chips,
    recorded_cli,
    recorded_commands,
    recorded_drivers,
    recorded_env_parts,
    recorded_envs,
    recorded_firmware,
    recorded_machines,
    recorded_met_ends,
    recorded_own,
    recorded_pages,
    recorded_panel,
    recorded_parts,
    recorded_promises,
    recorded_rerun,
    recorded_sim,
    recorded_stage,
    recorded_study,
    recorded_targets,
    recorded_texts,
    recorded_tune,
)

PHYSICS = {
    **recorded_cli.FILES, **recorded_texts.FILES, **recorded_stage.FILES, **recorded_firmware.FILES, **recorded_envs.FILES,
    **recorded_machines.FILES, **recorded_drivers.FILES, **recorded_panel.FILES,
    **recorded_tune.FILES, **recorded_agents_bus.FILES, **recorded_around_chips.FILES,
    **recorded_sim.FILES, **recorded_pages.FILES, **recorded_rerun.FILES, **recorded_own.FILES, **recorded_env_parts.FILES,
    **recorded_met_ends.FILES,
    **recorded_study.FILES,
    **recorded_boards.FILES, **recorded_targets.FILES, **recorded_promises.FILES, **recorded_parts.FILES,
    **recorded_commands.FILES,
}  # fmt: skip
"""What depends on MuJoCo's version."""
if find_spec("registerbench"):  # a package of its own, which the core runs without
    from recorded import recorded_agents, recorded_bench

    PHYSICS |= {**recorded_agents.FILES, **recorded_bench.FILES}
FILES = {**recorded_chips.FILES, **PHYSICS}
PACKAGES = {**recorded_pages.PACKAGES, **recorded_rerun.PACKAGES}
"""Files that depend on an optional package's version: what they show is partly that package's own."""
