"""Rows of a front panel by a browser's events, without a browser: what is written, what is shown, what is put together."""

from dataclasses import replace

import pytest

from stage.chips import HCTL1100, PCL240MS
from stage.errors import ArgumentError

pytest.importorskip("nicegui")
from nicegui import ui

from stage.panel import chip_panel as rows
from stage.panel import front_panel_content as front
from stage.panel.front_panel_content import (
    describe_lamp,
    describe_value,
    format_value,
    is_fixed,
    list_choices,
    replace_field,
)


@pytest.fixture(scope="module")
def page(served):
    return served.visit()


class RowOnPage:
    """A row of its own on a page: what it writes, and its parts."""

    def __init__(self, page, place):
        self.page, self.place, self.written = page, place, []

        async def write(place, value):
            self.written.append((place.name, value))

        def build():
            with page.client, ui.element("div") as self.box:
                self.row = rows.RegisterRow(place, write, "made")

        page.within(build)

    def update(self, value):
        self.page.within(lambda: self.row.show_chip_values({self.place.name: value, "another": 1}))

    def open(self):
        self.page.click("fields-made")

    def field(self, field):
        return next(control.element for control in self.row._fields if control.field is field)

    def set(self, field, value):
        """Set a field as a user does: a choice, a tick, a number and Enter."""
        widget = self.field(field)
        if isinstance(widget, ui.input):
            self.page.put(widget, str(value))
            self.page.fire(widget, "keydown.enter")
        else:
            self.page.put(widget, bool(value) if isinstance(widget, ui.checkbox) else value)

    @property
    def text(self):
        value = self.page.find("value-made")
        return value.value if isinstance(value, ui.input) else value.text

    @property
    def words(self):
        return self.row._words.text

    @property
    def flash(self):
        return [c for c in self.page.find("value-made").classes if c.startswith("flash")]


@pytest.fixture
def make_row(page):
    """made(place): a row; it is taken away again."""
    rows = []

    def make(place):
        rows.append(RowOnPage(page, place))
        return rows[-1]

    yield make
    for one in rows:
        page.within(one.box.delete)


def register(name, chip=PCL240MS):
    return chip.MAP.register(name)


def word(name, chip=PCL240MS):
    return next(w for w in front.FrontPanel(chip).forms if w.name == name)


def test_enter_writes_a_valid_number_and_shows_an_error_for_others(page, make_row):
    row = make_row(register("R1"))
    row.update(7)
    assert row.text == "7"
    page.enter("value-made", "64h")
    page.until(lambda: row.written)
    assert row.written == [("R1", 100)]
    assert row.text == "7", "what the chip holds, until it holds another"
    for typed, message in (("1O0", "Did you mean 100?"), ("", "a number is missing"), ("8192", "-4096 to 8191 fit")):
        page.enter("value-made", typed)
        page.until(lambda s=message: s in page.error("value-made"))
        assert row.text == typed
    page.enter("value-made", "8191")
    page.until(lambda: len(row.written) == 2)
    assert row.written[1] == ("R1", 8191)
    assert not page.error("value-made")


@pytest.mark.parametrize("sign", ["escape", "blur"])
def test_text_under_edit_remains_until_it_is_cancelled(page, make_row, sign):
    row = make_row(register("R1"))
    row.update(7)
    page.fire("value-made", "keydown", {"key": "Tab"})
    row.update(8)
    assert row.text == "8", "who passes by with Tab types nothing"
    page.fire("value-made", "keydown", {"key": "1"})
    page.settled()
    page.put("value-made", "12")
    row.update(9)
    assert row.text == "12"
    page.enter("value-made", "1x")
    page.until(lambda: page.error("value-made"))
    page.fire("value-made", *(("keydown", {"key": "Escape"}) if sign == "escape" else ("blur",)))
    page.until(lambda: row.text == "9")
    assert not page.error("value-made")
    row.update(10)
    assert row.text == "10"
    assert not row.written


def test_a_value_that_changes_flashes_and_another_axis_does_not(make_row):
    row = make_row(register("R1"))
    observed = []
    for value in (5, 5, 6, 6, 7, 8):
        row.update(value)
        observed.append(row.flash)
    assert observed == [[], [], ["flash-a"], ["flash-a"], ["flash-b"], ["flash-a"]]
    row.row.show_chip_values({"another": 3})
    assert row.text == "8"
    row.row.forget_value()
    row.update(9)
    assert (row.text, row.flash) == ("9", ["flash-a"])


def test_selecting_another_axis_ends_editing(page, make_row):
    row = make_row(register("R1"))
    row.update(7)
    page.fire("value-made", "keydown", {"key": "1"})
    page.settled()
    row.row.forget_value()
    row.update(8)
    assert row.text == "8"


def test_a_row_says_what_a_register_is_and_what_its_value_means(make_row):
    for chip in (PCL240MS, HCTL1100):
        for place in chip.MAP.registers:
            row = make_row(place)
            value = place.value(1 << place.bits - 2 | 1)
            row.update(value)
            can_write = "W" in place.access
            assert (row.text, row.words) == (format_value(place, value), describe_value(place, value))
            assert isinstance(row.page.find("value-made"), ui.input) == can_write
            texts = {getattr(e, "text", None) for e in row.box.descendants()}
            assert {place.name, place.title, place.evidence} <= texts
            titles = {e.props.get("title") for e in row.box.descendants()}
            assert {f"{front.describe_range(place)} {place.unit}", front.describe_evidence(place.evidence)} <= titles
            row.page.within(row.box.clear)


def everything(field):
    """Values of a field that differ: those of a list, else its ends and one between."""
    limit = (1 << field.high - field.low + 1) - 1
    return list(list_choices(field)) or sorted({0, 1, limit // 2, limit})


@pytest.mark.parametrize("name", ["R12", "R14", "R17"])
def test_each_field_of_a_register_is_shown_and_writes_its_own_bits(page, make_row, name):
    place = register(name)
    row, limit = make_row(place), (1 << place.bits) - 1
    row.update(0)
    row.open()
    fields = [f for f in place.fields if not is_fixed(f)]
    for field in fields:
        assert row.field(field).props["title"] == f"b{field.bits} {field.name}: {field.description} [{field.evidence}]"
    for current in (0x5A5A5A5A & limit, limit, 0):
        row.update(current)
        for field in fields:
            widget, value = row.field(field), field.extract(current)
            if "W" not in field.access:
                assert (widget.text, "on" in widget.classes) == describe_lamp(field, value)
                continue
            assert int(widget.value) == value, "also one that is in no list"
            for other in everything(field):
                if other == value:
                    continue
                row.written.clear()
                row.set(field, other)
                page.until(lambda: row.written)
                page.settled()
                assert row.written == [(name, replace_field(current, field, other))]
                row.update(replace_field(current, field, other))
                row.update(current)
                page.settled()
                assert int(widget.value) == value


def test_a_value_outside_the_map_is_shown_as_such(make_row):
    place = register("R13")
    fields = tuple(replace(f, values={2: "two", 5: "five"}) if f.name == "ez_count" else f for f in place.fields)
    field = next(f for f in fields if f.name == "ez_count")
    row = make_row(replace(place, fields=fields))
    row.update(3 << field.low)
    row.open()
    listed, strange = {2: "2  two", 5: "5  five"}, "  (not in the map)"
    for value in (3, 5, 7, 2):
        row.update(value << field.low)
        widget = row.field(field)
        assert widget.value == value
        if value in listed:
            assert listed.items() <= widget.options.items()
        else:
            assert widget.options == {**listed, value: f"{value}{strange}"}


def test_a_field_that_is_a_number_says_what_is_none(page, make_row):
    place = register("R17")
    field = next(f for f in place.fields if not is_fixed(f) and not list_choices(f) and f.high > f.low)
    row = make_row(place)
    row.update(0)
    row.open()
    name = row.field(field)
    for typed in ("x", str(1 << field.high - field.low + 1)):
        page.put(name, typed)
        page.fire(name, "keydown.enter")
        page.until(lambda: page.error(name))
        with pytest.raises(ArgumentError) as message:
            front.parse_number(typed, field.high - field.low + 1)
        assert page.error(name) == str(message.value)
        page.put(name, "1")
        page.fire(name, "keydown.enter")
        page.until(lambda: not page.error(name))
    page.until(lambda: len(row.written) == 2)


def test_fields_are_folded_again_and_stand_below_their_row(page, make_row):
    row = make_row(register("R12"))
    row.open()
    area = page.until(lambda: row.row._area)
    children = row.box.default_slot.children
    assert children.index(area) == len(children) - 1
    for visible in (False, True):
        row.open()
        page.until(lambda v=visible: area.visible == v)
    assert len([e for e in row.box.descendants() if e is area]) == 1


def test_fields_of_a_row_stand_before_the_next_row(page, make_row):
    def both():
        with page.client, ui.element("div") as box:
            return (
                box,
                rows.RegisterRow(register("R12"), None, "first"),
                rows.RegisterRow(register("R1"), None, "second"),
            )

    box, first, _ = page.within(both)
    page.click("fields-first")
    children = box.default_slot.children
    assert children.index(first._area) == len(children) // 2
    page.within(box.delete)


def test_a_write_only_word_is_composed_of_its_fields_and_sent_by_a_button(page, make_row):
    place = word("output")
    row = make_row(place)
    row.open()
    fields = [f for f in place.fields if not is_fixed(f)]
    selected = {}
    composed = place.fixed
    for field in fields:
        selected[field.name] = value = everything(field)[-1]
        row.set(field, value)
        page.settled()
        composed = replace_field(composed, field, value)
        assert (row.text, row.words) == (format_value(place, composed), describe_value(place, composed))
    assert composed & ~place.fixed, selected
    assert not row.written
    page.click("send-made")
    page.until(lambda: row.written)
    assert row.written == [("output", composed)]
    page.click("send-made")
    page.until(lambda: len(row.written) == 2)
    page.settled()
    assert row.written[1] == row.written[0], "it stands there still, and can be sent again"
    assert (row.text, row.words) == (format_value(place, composed), describe_value(place, composed))
    page.enter("value-made", str(place.fixed))
    page.until(lambda: len(row.written) == 3)
    page.settled()
    assert (row.text, row.words) == (format_value(place, place.fixed), describe_value(place, place.fixed))
    page.put("value-made", "zz")
    page.click("send-made")
    page.until(lambda: page.error("value-made"))
    assert len(row.written) == 3


def test_a_register_of_which_nothing_is_known_yet_is_put_together_of_its_fields(page, make_row):
    place = register("R13")
    row = make_row(place)
    row.open()
    field = next(f for f in place.fields if list_choices(f))
    row.set(field, 1)
    page.settled()
    assert row.text == format_value(place, replace_field(0, field, 1))
    assert not row.written
    row.update(0)
    assert row.text == format_value(place, 0)


def test_a_number_in_a_composed_word_changes_its_bits_only_and_must_be_valid(page, make_row):
    """Two's complement is cut to the field; what is no number is said there, and no word is made of it."""
    place = word("output")
    row = make_row(place)
    row.open()
    stored = next(f for f in place.fields if f.name == "stored")
    other = next(f for f in place.fields if list_choices(f) and f.low > stored.high)
    row.set(stored, -1)
    page.settled()
    before = replace_field(place.fixed, stored, -1)
    assert row.text == format_value(place, before)
    row.set(other, 1)
    page.settled()
    both = replace_field(before, other, 1)
    assert row.text == format_value(place, both)
    page.put(row.field(stored), "x")
    row.set(other, 0)
    page.until(lambda: page.error(row.field(stored)))
    assert row.text == format_value(place, both)
    row.set(stored, 1)
    page.settled()
    assert row.text == format_value(place, replace_field(place.fixed, stored, 1))


def test_a_readable_word_lights_its_lamps_and_is_hidden_without_a_value(page):
    lamps = front.FrontPanel(PCL240MS).lamps
    assert lamps

    def build(place):
        with page.client, ui.element("div") as box:
            return box, rows.LampRow(place)

    for place in lamps:
        box, row = page.within(lambda p=place: build(p))
        assert row._head.props["title"] == place.description
        assert [lamp.props["title"] for _, lamp in row._lamps] == [
            f"b{f.bits} {f.name}: {f.description} [{f.evidence}]" for f in place.fields
        ]
        for value in ((1 << place.bits) - 1, 0, 0x55 & (1 << place.bits) - 1):
            row.show_chip_values({place.name: value})
            assert row._line.visible
            assert row._head.text == f"{place.name} {format_value(place, value)}"
            assert [(lamp.text, "on" in lamp.classes) for _, lamp in row._lamps] == [
                describe_lamp(f, f.extract(value)) for f in place.fields
            ]
        row.show_chip_values({})
        assert not row._line.visible
        row.show_chip_values({place.name: 1})
        row.forget_value()
        row._head.text = "of another axis"
        row.show_chip_values({place.name: 1})
        assert row._head.text == f"{place.name} {format_value(place, 1)}"
        page.within(box.delete)


def test_a_register_of_the_chip_is_written_on_its_page_and_of_the_chip_of_that_page(served, page):
    session = served.session
    page.put("chip-1", True)
    page.until(lambda: page.all("value-1-R1"))
    page.enter("value-1-R1", "321")
    page.until(lambda: page.find("value-1-R1").value == "321")
    current = session.do(lambda stage: [chip.axis_values(0)["R1"] for chip in stage.chips])
    assert current == [0, 321]
    assert not page.said
