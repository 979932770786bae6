"""Lazy import of rerun for all modules that write or show recordings.

rerun is an optional dependency (an extra). Using one of these names without it raises ExtraMissing.
"""

from stage.support.extras import LazyModule

rr = LazyModule("rerun", "a recording (.rrd)")
rrb = LazyModule("rerun.blueprint", "a recording (.rrd)")
experimental = LazyModule("rerun.experimental", "a picture of a recording (.rrd)")


def release_streams() -> None:
    """Free the threads and the memory of every recording stream that is no longer referenced.

    rerun (0.41) keeps two threads and some MB for each stream and each blueprint until this function is called.
    """
    rr.bindings.flush_and_cleanup_orphaned_recordings()
