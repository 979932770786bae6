"""Firmware in a process of its own: `runner` is the board's side, `starter` begins the process, `child` is what it runs."""
