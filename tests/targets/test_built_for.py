"""A program for another processor of the same family is refused, as far as its file tells."""

import shutil
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from support.target_boards import board_of

from stage.board import LibraryError
from stage.targets import TargetHost, supported_processors
from stage.targets.elf import ARM, AVR, Elf, check_arm, get_avr_architecture, read_avr_name, read_mmcu

DATA = Path(__file__).parent / "data"
PINS = "data=A,address=C:0-3,cs=B0,wr=G0,rd=G1"
WINDOW = "0x40021000=0x300+0x40"
NAME, FLAGS_AT = b"atmega2560\0", 36


def changed_avr(tmp_path: Path, name: bytes, architecture: int) -> Path:
    content = bytearray((DATA / "faults.avr.elf").read_bytes().replace(NAME, name.ljust(len(NAME), b"\0")))
    content[FLAGS_AT] = architecture
    path = tmp_path / "changed.elf"
    path.write_bytes(content)
    return path


def avr(path: Path, mcu: str) -> TargetHost:
    return TargetHost(path, board_of(), mcu=mcu, map=PINS, isolated=False)


@pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)
@pytest.mark.parametrize(
    ("name", "architecture", "mcu", "pattern"),
    [
        (b"atmega2560", 6, "atmega328p", r"for atmega2560 \(architecture avr6\), and atmega328p is an avr5. Run it with --mcu "
         r"atmega2560, or build it by avr-gcc -mmcu=atmega328p"),
        (b"", 6, "atmega328p", r"for an AVR of the architecture avr6, and atmega328p is an avr5. Build it by"),
        (b"atmega328p", 5, "atmega2560", r"for atmega328p \(architecture avr5\), and atmega2560 is an avr6"),
        (b"atmega644p", 5, "atmega328p", r"for atmega644p .*Run it with --mcu atmega644p"),
        (b"atmega2561", 6, "atmega328p", r"for atmega2561 \(architecture avr6\).*\. Build it by"),
    ],
)  # fmt: skip
def test_a_program_of_another_avr_is_refused(tmp_path, name, architecture, mcu, pattern):
    with pytest.raises(LibraryError, match=pattern):
        avr(changed_avr(tmp_path, name, architecture), mcu)


@pytest.mark.skipif(
    not supported_processors.has_simavr(), reason=f"there is no {supported_processors.SIMAVR_REQUIREMENT}"
)
@pytest.mark.parametrize(("name", "architecture"), [(b"atmega2561", 6), (b"", 6), (b"", 2)])
def test_a_program_of_a_similar_or_unnamed_avr_runs(tmp_path, name, architecture):
    assert avr(changed_avr(tmp_path, name, architecture), "atmega2560").run().code == 0


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("avr-gcc") is None, reason="there is no avr-gcc")
def test_architectures_and_names_are_those_of_the_compiler(tmp_path):
    source, built = tmp_path / "e.c", tmp_path / "e.elf"
    source.write_text("int main(void) { return 0; }\n")
    known = 0
    for mcu in supported_processors.AVRS:
        command = ["avr-gcc", f"-mmcu={mcu}", str(source), "-o", str(built)]
        if (
            subprocess.run(command, capture_output=True, check=False).returncode == 0
        ):  # a few the compiler does not have
            elf = Elf(built, AVR, mcu, "")
            assert (elf.flags & 0x7F, read_avr_name(elf)) == (get_avr_architecture(mcu), mcu)
            known += 1
    assert known > 40


def changed_arm(tmp_path: Path, arch: int, profile: bytes = b"M") -> Path:
    content = (DATA / "faults.m3.elf").read_bytes()
    was = bytes((6, 10, 7)) + b"M"
    assert content.count(was) == 1
    path = tmp_path / "changed.elf"
    path.write_bytes(content.replace(was, bytes((6, arch, 7)) + profile))
    return path


@pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)
@pytest.mark.parametrize(
    ("arch", "profile", "mcu", "pattern"),
    [
        (10, b"M", "cortex-m0", r"for v7-M \(Cortex-M3\), and this is a cortex-m0. Run it with --mcu cortex-m3, or build it by "
         r"arm-none-eabi-gcc -mcpu=cortex-m0"),
        (13, b"M", "cortex-m3", r"for v7E-M \(Cortex-M4, M7\), and this is a cortex-m3. Run it with --mcu cortex-m4"),
        (17, b"M", "cortex-m4", r"for v8-M \(Cortex-M33\), and this is a cortex-m4. Build it by"),
        (10, b"A", "cortex-m4", r"for a Cortex-A, and this is a cortex-m4. Build it by"),
    ],
)  # fmt: skip
def test_a_program_of_a_larger_cortex_is_refused(tmp_path, arch, profile, mcu, pattern):
    with pytest.raises(LibraryError, match=pattern):
        TargetHost(changed_arm(tmp_path, arch, profile), board_of(), mcu=mcu, map=WINDOW, isolated=False)


@pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)
@pytest.mark.parametrize(("arch", "mcu"), [(10, "cortex-m4"), (11, "cortex-m3")])
def test_a_program_of_a_smaller_cortex_runs(tmp_path, arch, mcu):
    h = TargetHost(changed_arm(tmp_path, arch), board_of(9), mcu=mcu, map=WINDOW, isolated=False)
    assert h.run().code == 9


def file_with(**tags: int) -> SimpleNamespace:
    """Stand for a file with build attributes, and nothing else."""
    return SimpleNamespace(path=Path("floats.elf"), attributes=tags)


def test_damaged_build_attributes_are_ignored(tmp_path):
    content = (DATA / "faults.m3.elf").read_bytes()
    assert Elf(DATA / "faults.m3.elf", ARM, "cortex-m3", "").attributes["TAG_CPU_ARCH"] == 10
    damaged = content.replace(b"aeabi\0\1", b"aeabi\0\xff")
    assert damaged != content
    (tmp_path / "damaged.elf").write_bytes(damaged)
    assert Elf(tmp_path / "damaged.elf", ARM, "cortex-m3", "").attributes == {}


@pytest.mark.parametrize("tag", ["TAG_FP_ARCH", "TAG_ABI_VFP_ARGS"])
def test_floating_point_arguments_need_a_floating_point_unit(tag):
    """-mfloat-abi=hard in a file that computes with whole numbers only has its arguments there"""
    check_arm(file_with(TAG_CPU_ARCH=10, **{tag: 1}), "cortex-m4", "")
    with pytest.raises(LibraryError, match=r"a floating-point unit, and this is a cortex-m3.*--mcu cortex-"):
        check_arm(file_with(TAG_CPU_ARCH=10, **{tag: 1}), "cortex-m3", "arm-none-eabi-gcc -mcpu={mcu}")


@pytest.mark.parametrize(
    ("mcu", "architecture"),
    [("attiny85", 25), ("at90usb162", 35), ("atmega2560", 6), ("atmega1280", 51), ("atmega128", 51), ("atmega328p", 5),
     ("atmega8", 4), ("atmega88pa", 4), ("atmega644p", 5)],
)  # fmt: skip
def test_each_mcu_has_the_architecture_that_avr_gcc_writes_for_it(mcu, architecture):
    assert get_avr_architecture(mcu) == architecture


def test_every_tag_of_mmcu_is_read_with_its_bytes():
    tags = {1: b"atmega2560\0", 2: (16_000_000).to_bytes(4, "little"), 7: b"\1"}
    content = b"".join(bytes([tag, len(value)]) + value for tag, value in tags.items()) + b"\0\0"
    assert read_mmcu(SimpleNamespace(segments=[], read_section={".mmcu": content}.get)) == tags
