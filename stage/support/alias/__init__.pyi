from stage import *  # noqa: F403
from stage import __version__ as __version__
from stage import agents as agents
from stage import board as board
from stage import chips as chips
from stage import drives as drives
from stage import envs as envs
from stage import errors as errors
from stage import firmware as firmware
from stage import recording as recording
from stage import study as study
from stage import testing as testing
from stage import units as units
