"""The bus cycles of a host, compiled: `requests` makes them, `host_record` is their state, `waiting` lets time pass."""
