"""How long machines run: every day for seconds, with `-m slow` for minutes."""

from hypothesis import HealthCheck, settings

_COMMON = {"deadline": None, "suppress_health_check": list(HealthCheck), "print_blob": True}


def everyday(examples: int, steps: int = 30) -> settings:
    return settings(max_examples=examples, stateful_step_count=steps, **_COMMON)


def long(examples: int, steps: int = 60) -> settings:
    return settings(max_examples=examples, stateful_step_count=steps, **_COMMON)
