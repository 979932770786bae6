"""Loops of tests over the chips' cores, compiled: a package from outside PulseStage, with a native library of its own."""
