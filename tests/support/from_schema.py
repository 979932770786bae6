"""Hypothesis strategies of JSON schemas as tools have them: what fits, and what nearly does."""

from hypothesis import strategies as st

from stage.agents.tool_arguments import INTEGER_PATTERN, LENGTH_PATTERN, LENGTH_WITH_UNIT_PATTERN

FORMS = ("{}{}", "{}{:X}h", "{}0x{:x}", "{}0b{:b}")
JUNK = st.one_of(
    st.none(), st.booleans(), st.integers(-(2**70), 2**70), st.floats(), st.text(max_size=20), st.just("1e999"),
    st.sampled_from(["NaN", "²", "٣", "0x", "h", "-", "1Fh", "X", "R0", "\0", "main", "../x", "10mm", "9" * 300]),
    st.lists(st.integers(-300, 300), max_size=5), st.dictionaries(st.text(max_size=5), st.integers(), max_size=3),
)  # fmt: skip


INTEGERS = st.integers(-(2**33), 2**33)
PATTERNS = {
    INTEGER_PATTERN: st.one_of(
        *(INTEGERS.map(lambda n, form=form: form.format("-" * (n < 0), abs(n))) for form in FORMS)
    ),
    LENGTH_PATTERN: st.tuples(st.floats(-10, 10), st.sampled_from(["", "mm", " um", "m", "deg"])).map(
        lambda two: f"{two[0]}{two[1]}"
    ),
    LENGTH_WITH_UNIT_PATTERN: st.tuples(st.floats(-10, 10), st.sampled_from(["mm", " um", "m", "deg"])).map(
        lambda two: f"{two[0]}{two[1]}"
    ),
}
"""Texts by the patterns that schemas have."""


def fits(schema):
    """Values that the schema allows."""
    if "anyOf" in schema:
        return st.one_of(*(fits(one) for one in schema["anyOf"]))
    if "enum" in schema or "const" in schema:
        return st.sampled_from(schema.get("enum") or [schema["const"]])
    kind = schema["type"]
    if kind == "boolean":
        return st.booleans()
    if kind == "string":
        return PATTERNS[schema["pattern"]] if "pattern" in schema else st.text(max_size=30)
    if kind in ("integer", "number"):
        low = schema.get("minimum", schema.get("exclusiveMinimum"))
        high = schema.get("maximum")
        if kind == "integer":
            return st.integers(low, high)
        how = {"exclude_min": True} if "exclusiveMinimum" in schema else {}
        return st.floats(low, high, allow_nan=False, allow_infinity=False, **how)
    if kind == "array":
        return st.lists(fits(schema["items"]), min_size=schema.get("minItems", 0), max_size=6)
    if "propertyNames" in schema:
        return st.dictionaries(
            fits(schema["propertyNames"] | {"type": "string"}), fits(schema["additionalProperties"]), min_size=1
        )
    properties, required = schema["properties"], schema.get("required", [])
    optional = {name: fits(one) for name, one in properties.items() if name not in required}
    return st.fixed_dictionaries({name: fits(properties[name]) for name in required}, optional=optional)


def nearly(schema):
    """Arguments of a tool with something wrong in them, as a rule."""
    names = st.one_of(st.sampled_from([*schema["properties"], "axis"]), st.text(max_size=8))
    spoilt = st.dictionaries(names, JUNK, max_size=3)
    return st.one_of(JUNK, st.tuples(fits(schema), spoilt).map(lambda two: {**two[0], **two[1]}))


def calls(tools):
    """(name, arguments) of calls: most by the schemas, some not."""
    ones = [st.tuples(st.just(name), st.one_of(fits(t.schema()), nearly(t.schema()))) for name, t in tools.items()]
    return st.one_of(*ones, st.tuples(st.text(max_size=12), JUNK))
