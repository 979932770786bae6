"""One stage in MuJoCo: the engine that runs chips, drives and physics under one clock, `Stage`, `Fleet`, faults."""
