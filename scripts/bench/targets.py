"""Targets of the benchmark: one list of bounds for the medians of figures."""

from bench.figures import Target

TARGETS = (
    Target("closed loop, recording off", "closed_loop.off", ">=", 0.92),
    Target("closed loop, recording on", "closed_loop.on", ">=", 0.7),
    Target("without visuals, recording off", "closed_loop.off_fast", ">=", 0.85),
    Target("without visuals, recording on", "closed_loop.on_fast", ">=", 0.7),
    Target("fleet, two threads", "vector.fleet_two", ">=", 1.7),
    Target("fleet of Batch, one thread", "vector.fleet_batch_1", ">=", 0.75),
    Target("fleet of Batch, two threads", "vector.fleet_batch_2", ">=", 0.85),
    Target("vector env, two threads", "vector.env_two", ">=", 1.7),
    Target("vector env of Batch, one thread", "vector.env_batch_1", ">=", 0.75),
    Target("vector env of Batch, two threads", "vector.env_batch_2", ">=", 0.75),
    *(Target(f"env overhead, {k} physics steps", f"environment.overhead_{k}", "<=", 1.0) for k in (1, 4, 40)),
    Target("chip at constant speed", "chips.constant", ">=", 1e9),
    Target("traced pulses", "chips.traced", ">=", 1e7),
    Target("MCX514 in the closed loop, beside PCL240K", "nova.closed_loop", "<=", 1.5),
    Target("MCX514 at constant speed, beside PCL240K", "nova.advance", "<=", 1.5),
    Target("MCX514 traced at constant speed, beside PCL240K", "nova.constant", "<=", 1.5),
    Target("MCX514 traced at constant speed", "nova.constant_rate", ">=", 1e7),
    Target("MCX514 traced in a ramp", "nova.ramp_rate", ">=", 1e7),
    Target("HCTL1100 in the closed loop, beside PCL240K", "hctl1100.closed_loop", "<=", 1.5),
    Target("bus cycles from C", "firmware.tight", ">=", 3e6),
    Target("cost over axes", "scaling.axes_exponent", "<=", 1.05),
    Target("cost over stages", "scaling.stages_exponent", "<=", 1.05),
    Target("cost over run length", "long_run.length_exponent", "<=", 1.05),
    Target("cost over run length, recorded", "long_run.length_recorded_exponent", "<=", 1.05),
    Target("growth", "long_run.growth", "<=", 1.0),
    Target("growth, recorded", "long_run.growth_recorded", "<=", 1.0),
    Target("import", "startup.import", "<=", 0.5),
    Target("a first step beside MuJoCo's own", "startup.warm_bare", "<=", 1.3),
    Target("building the native library, processor time", "startup.build", "<=", 40.0),
)
BY_FIGURE = {t.figure: t for t in TARGETS}
