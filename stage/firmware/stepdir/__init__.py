"""How a host drives STEP/DIR axes: by the step timer of each, which makes the steps in compiled code."""
