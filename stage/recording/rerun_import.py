"""rerun, for all that write or show recordings. It is an extra: whoever uses one of these without it gets ExtraMissing."""

from stage.support.extras import LazyModule

rr = LazyModule("rerun", "a recording (.rrd)")
rrb = LazyModule("rerun.blueprint", "a recording (.rrd)")
experimental = LazyModule("rerun.experimental", "a picture of a recording (.rrd)")


def release_streams() -> None:
    """Free the threads and the memory of every recording stream that nobody refers to any more.

    rerun (0.41) keeps two threads and some MB of each stream, and of each blueprint, until this is called.
    """
    rr.bindings.flush_and_cleanup_orphaned_recordings()
