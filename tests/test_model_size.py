"""Models that expand beyond bounds are refused before MuJoCo reads them; those within, and any that a person writes, are read."""

import os
import struct
import time

import pytest

from stage import ModelError, Stage
from stage.sim.plant import open_spec
from stage.sim.plant.model_file_limits import MAX_COMPOSITE_BODIES, MAX_ELEMENTS, MAX_SAMPLES, check_model_size

NESTED = (
    '<worldbody><replicate count="1000" offset="1 0 0"><replicate count="1000" offset="0 1 0"><geom size=".1"/>'
    "</replicate></replicate></worldbody>"
)
OVERSIZED_MODELS = {
    "nested replicates": (NESTED, "1,001,003 elements at its <geom>"),
    "replicate": ('<worldbody><replicate count="20001"><site/></replicate></worldbody>', "elements at its <site>"),
    "composite": (
        '<worldbody><body><composite type="cable" count="100000 1 1"><geom size=".01"/></composite></body></worldbody>',
        "100,0.. elements at its <composite>",
    ),
    "chain": (
        '<worldbody><body><composite type="cable" count="1001 1 1"><geom size=".01"/></composite></body></worldbody>',
        "1,001 bodies at its <composite>, and a model may have 1,000",
    ),
    "flex": (
        '<worldbody><flexcomp name="f" type="grid" count="50 50 50"/></worldbody>',
        "125,00. elements at its <flexcomp>",
    ),
    "height field": (
        '<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>',
        "10,000,000,000 samples",
    ),
    "texture": (
        '<asset><texture name="t" builtin="flat" width="100000" height="100000"/></asset>',
        "10,000,000,000 pixels",
    ),
    "keyframes": ('<size nkey="2000000"/>', "2,000,000 nkey at its <size>"),
    "points of a chain": (
        f'<worldbody><body><composite type="cable" vertex="{"0 0 0 " * 1001}"><geom size=".01"/></composite></body></worldbody>',
        "1,001 bodies at its <composite>",
    ),
    "height fields together": (
        "<asset>" + '<hfield nrow="4000" ncol="4000" size="1 1 1 1"/>' * 5 + "</asset>",
        "80,000,000 samples",
    ),
    "textures together": (
        "<asset>" + '<texture builtin="flat" width="4000" height="4000"/>' * 5 + "</asset>",
        "80,000,000 pixels",
    ),
    "channels": ('<asset><texture builtin="flat" width="4000" height="4000" nchannel="1000"/></asset>', "pixels"),
    "made mesh": ('<asset><mesh builtin="supertorus" params="100000 1 1 1"/></asset>', "100,000 segments a side"),
    "sensors": ('<sensor><user dim="100000000"/></sensor>', "100,000,000 readings at its <user>"),
    "sensors together": ("<sensor>" + '<user dim="500000"/>' * 3 + "</sensor>", "1,500,000 readings at its <user>"),
    "contacts": ('<sensor><contact num="2000000000"/></sensor>', "2,000,000,000 readings"),
    "delays": ('<actuator><motor nsample="10000000"/></actuator>', "10,000,000 readings"),
    "user data together": (
        '<size nuser_geom="100000"/><worldbody><replicate count="10000"><geom size=".1"/></replicate></worldbody>',
        "1,000,400,000 numbers of user data",
    ),
    "elements of the file": (
        "<worldbody>" + "<site/>" * 30_000 + "</worldbody>",
        "more than 20,000 elements, at its <site>",
    ),
    "user data of geoms": ('<size nuser_geom="200000000"/>', "200,000,000 nuser_geom"),
}


def write_model(folder, body, name="model.xml"):
    path = folder / name
    path.write_text(f"<mujoco>{body}</mujoco>")
    return path


@pytest.mark.parametrize("what", OVERSIZED_MODELS)
def test_a_model_beyond_the_bounds_is_refused_at_once(what, tmp_path):
    body, message = OVERSIZED_MODELS[what]
    began = time.process_time()
    with pytest.raises(ModelError, match=message):
        Stage(write_model(tmp_path, body))
    assert time.process_time() - began < 1.0, "MuJoCo has not read it"


def test_a_model_at_the_bounds_is_accepted(tmp_path):
    elements = MAX_ELEMENTS - 3  # mujoco, worldbody, replicate
    check_model_size(write_model(tmp_path, f'<worldbody><replicate count="{elements}"><geom/></replicate></worldbody>'))
    with pytest.raises(ModelError):
        check_model_size(
            write_model(tmp_path, f'<worldbody><replicate count="{elements + 1}"><geom/></replicate></worldbody>')
        )
    check_model_size(write_model(tmp_path, f'<worldbody><composite count="{MAX_COMPOSITE_BODIES} 1 1"/></worldbody>'))
    check_model_size(write_model(tmp_path, f'<asset><hfield nrow="{MAX_SAMPLES // 4096}" ncol="4096"/></asset>'))


def test_files_that_a_model_includes_or_attaches_are_counted_each_time(tmp_path):
    write_model(tmp_path, '<worldbody><replicate count="150"><geom/></replicate></worldbody>', "part.xml")
    check_model_size(
        write_model(tmp_path, '<worldbody><replicate count="100"><include file="part.xml"/></replicate></worldbody>')
    )
    body = '<worldbody><replicate count="200"><include file="part.xml"/></replicate></worldbody>'
    with pytest.raises(ModelError, match="elements at its <geom>"):
        check_model_size(write_model(tmp_path, body))
    body = (
        '<asset><model name="m" file="part.xml"/></asset><worldbody><replicate count="200"><attach model="m" body="b"/>'
        "</replicate></worldbody>"
    )
    with pytest.raises(ModelError, match="elements at its <geom>"):
        check_model_size(write_model(tmp_path, body))


def test_sensors_of_an_attached_model_are_counted_each_time(tmp_path):
    write_model(tmp_path, '<sensor><user dim="10000"/></sensor>', "part.xml")
    body = (
        '<asset><model name="m" file="part.xml"/></asset><worldbody><replicate count="{}"><attach model="m"/></replicate>'
        "</worldbody>"
    )
    check_model_size(write_model(tmp_path, body.format(104)))
    with pytest.raises(ModelError, match="1,050,000 readings at its <user>, and a model may have 1,048,576"):
        check_model_size(write_model(tmp_path, body.format(105)))


def test_a_model_that_includes_itself_is_refused(tmp_path):
    path = write_model(tmp_path, '<include file="model.xml"/>')
    with pytest.raises(ModelError, match="includes itself"):
        open_spec(path)


@pytest.mark.parametrize("tag", ['mesh name="m"', 'hfield name="h"', 'texture name="t" type="2d"', "include"])
def test_a_file_of_a_model_that_is_a_pipe_is_refused_and_not_opened(tag, tmp_path):
    os.mkfifo(tmp_path / "pipe.stl")
    element = f'<{tag} file="pipe.stl"/>'
    with pytest.raises(ModelError, match=r"pipe.stl is a pipe"):
        open_spec(write_model(tmp_path, element if tag == "include" else f"<asset>{element}</asset>"))
    (tmp_path / "meshes").mkdir()
    os.rename(tmp_path / "pipe.stl", tmp_path / "meshes" / "pipe.stl")
    if tag.startswith("mesh"):
        with pytest.raises(ModelError, match=r"pipe.stl is a pipe"):
            open_spec(write_model(tmp_path, f'<compiler meshdir="meshes"/><asset>{element}</asset>'))


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null"])
def test_a_model_that_is_a_device_is_refused(path):
    with pytest.raises(ModelError, match="is a device"):
        open_spec(path)


def test_what_is_no_xml_is_refused_with_the_place(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text("<mujoco><worldbody></mujoco>")
    with pytest.raises(ModelError, match=r"not well-formed XML \(mismatched tag: line 1, column 2\d\)"):
        open_spec(path)


def test_dashes_in_comments_and_bytes_that_are_not_utf_8_are_read_as_mujoco_reads_them(tmp_path):
    path = tmp_path / "model.xml"
    body = b'<worldbody><geom size=".1"/></worldbody>'
    path.write_bytes(
        b'<?xml version="1.0"?>\n<!-- ---- Gr\xfc\xdfe -- ---- -->\n<mujoco><!-- -- -->' + body + b"</mujoco>"
    )
    assert len(list(open_spec(path).geoms)) == 1


HIDDEN = {
    "a document type that MuJoCo ends before its comment does": (
        "<!DOCTYPE m [ <!-- ]><mujoco>{bomb}</mujoco><!-- --> ]><mujoco/>",
    ),
    "a name": ('<mujoco><worldbody><site name="<!--"/></worldbody>{bomb}<!-- --></mujoco>',),
    "a section of text": ("<mujoco><![CDATA[<!--]]>{bomb}<!-- --></mujoco>",),
    "an unknown declaration": ("<mujoco><!a <!-- >{bomb}<!-- --></mujoco>",),
    "an instruction before the model": ("<?x <!-- ?><mujoco>{bomb}<!-- --></mujoco>",),
}


@pytest.mark.parametrize("where", HIDDEN)
def test_no_comment_hides_elements_that_mujoco_reads(where, tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(HIDDEN[where][0].format(bomb=NESTED))
    with pytest.raises(ModelError, match=r"1,001,00. elements|not well-formed"):
        check_model_size(path)


def test_texts_that_only_mujoco_takes_are_read_as_it_reads_them(tmp_path):
    path = tmp_path / "model.xml"
    path.write_bytes(
        b'<!DOCTYPE m [<!ENTITY n "2">]><mujoco model="a & b &n;"><worldbody><site name="\x01"/></worldbody></mujoco>\0'
    )
    assert open_spec(path).modelname == "a & b &n;"


def test_a_picture_in_a_file_counts_by_its_header(tmp_path):
    (tmp_path / "bomb.png").write_bytes(
        b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">II", 20_000, 20_000) + b"\0" * 20
    )
    for element in (
        '<texture name="t" type="2d" file="bomb.png"/>',
        '<hfield name="h" file="bomb.png" size="1 1 1 1"/>',
    ):
        with pytest.raises(ModelError, match=r"400,000,00\d "):
            check_model_size(write_model(tmp_path, f"<asset>{element}</asset>"))


def test_a_file_of_points_that_become_bodies_is_bounded(tmp_path):
    (tmp_path / "points.obj").write_bytes(b"v 0 0 0\n" * 300_000)
    element = '<worldbody><flexcomp name="f" type="mesh" file="points.obj" dim="2"/></worldbody>'
    with pytest.raises(
        ModelError, match=r"points.obj has 2,400,000 bytes, and a file of a model has at most 2,097,152"
    ):
        check_model_size(write_model(tmp_path, element))


def test_an_unknown_exception_of_mujoco_is_a_model_error(monkeypatch, tmp_path):
    def fail(*_):
        raise RuntimeError("Caught an unknown exception!")

    monkeypatch.setattr("mujoco.MjSpec.from_file", fail)
    with pytest.raises(ModelError, match="Caught an unknown exception"):
        open_spec(write_model(tmp_path, ""))
