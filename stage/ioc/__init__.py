"""A simulated motor controller for laboratories: an EPICS IOC with a motor record for each axis of a stage (`stage ioc`).

    clients: ophyd, bluesky, pyepics, caproto-get ...
      |  Channel Access
    server            PVs of the stage, by caproto, in an asyncio loop
    motor_record      semantics of the EPICS motor record: user and dial coordinates, limits, retries, backlash
    motion_controller axes in dial units; a session of the stage in real time, in its own thread
      |  stage.firmware: begin_move, begin_home, begin_jog, begin_stop
    chips, drives, physics

`motion_controller` knows no EPICS. The extra `epics` installs caproto. docs/epics.md is the page for users.
"""
