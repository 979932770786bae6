"""The bus cycles of a host, compiled: `host_requests` makes them, `host_record` is their state, `host_time` lets time pass."""
