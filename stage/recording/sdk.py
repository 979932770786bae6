"""rerun, for all that write or show recordings. It is an extra: whoever uses one of these without it gets ExtraMissing."""

from stage.extras import Later

rr = Later("rerun", "a recording (.rrd)")
rrb = Later("rerun.blueprint", "a recording (.rrd)")
experimental = Later("rerun.experimental", "a picture of a recording (.rrd)")
chunk = Later("rerun.chunk", "reading a recording (.rrd)")
