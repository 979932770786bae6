"""MJCF stages that ship with PulseStage; each loads in any MuJoCo viewer."""
