"""FreeRTOS on an emulated board: the port layer with a minimal kernel; and the original kernel if FREERTOS_KERNEL names
its folder (github.com/FreeRTOS/FreeRTOS-Kernel is not part of this repository)."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from stage import Stage
from stage.board import Board, CompileError, NativeHost, build
from stage.chips import PCL240MK
from stage.targets import TargetHost, supported_processors

EXAMPLES = Path(__file__).resolve().parents[2] / "scripts" / "firmware"
KERNEL = Path(os.environ.get("FREERTOS_KERNEL", "/nowhere"))
needs_kernel = pytest.mark.skipif(
    not (KERNEL / "tasks.c").is_file(), reason="FREERTOS_KERNEL names no folder of FreeRTOS-Kernel"
)
FIRMWARE_SOURCES = [EXAMPLES / "freertos/drive_and_watch.c", EXAMPLES / "pcl240mk/pcl240.c"]
FOLDERS = [
    f"-I{folder}" for folder in (EXAMPLES / "freertos", EXAMPLES / "hal", EXAMPLES / "pcl240mk", KERNEL / "include")
]

FREERTOS_H = """
#pragma once
#include <FreeRTOSConfig.h>
#include <portmacro.h>
#define pdTRUE 1
#define pdFALSE 0
typedef void (*TaskFunction_t)(void *);
StackType_t *pxPortInitialiseStack(StackType_t *, TaskFunction_t, void *);
BaseType_t xPortStartScheduler(void), xTaskIncrementTick(void);
void vPortEndScheduler(void), vTaskSwitchContext(void), vTaskDelete(void *), *pvPortMalloc(size_t), vPortFree(void *);
char *pcTaskGetName(void *);
void vApplicationIdleHook(void);
"""
TINY = """
#include <FreeRTOS.h>
struct tcb { StackType_t *top; uint32_t wakes; StackType_t stack[8]; } tasks[4], *volatile pxCurrentTCB;
static uint32_t now;
static int n, late;
static volatile int interrupts, order;

BaseType_t xTaskIncrementTick(void) { now++; return pdTRUE; }
void vTaskSwitchContext(void) /* the first that is ready; the last is idle */
{
    int k = 0;
    while (k < n - 1 && (int32_t)(now - tasks[k].wakes) < 0)
        k++;
    pxCurrentTCB = &tasks[k];
}
void vTaskDelete(void *task) { (void)task; pxCurrentTCB->wakes = now + 1000000; vPortYield(); }
char *pcTaskGetName(void *task) { (void)task; return "short"; }
static void sleeps(uint32_t ticks)
{
    portENTER_CRITICAL();
    pxCurrentTCB->wakes = now + ticks;
    portYIELD(); /* in a critical section: it belongs to this task */
    portEXIT_CRITICAL();
}
static void make(TaskFunction_t run, uint32_t from)
{
    tasks[n].wakes = from;
    tasks[n].top = pxPortInitialiseStack(tasks[n].stack + 8, run, (void *)(intptr_t)n);
    n++;
}
static void line(void *argument)
{
    (void)argument;
    ps_out8(0x300, 0x08); /* lets go of the line */
    interrupts++;
    tasks[0].wakes = now;
    portYIELD_FROM_ISR(pdTRUE);
    order = 1; /* the change comes when the routine has returned */
}
static void urgent(void *argument)
{
    static const unsigned move[] = {0, 0x08, 0, 0x80, 1, 30, 0, 0x81, 1, 50, 0, 0x87, 1, 30, 0, 0x44, 0, 0x30};
    unsigned k;
    (void)argument;
    sleeps(5);
    for (k = 0; k < sizeof move / sizeof *move; k += 2)
        ps_out8(0x300 + move[k], (uint8_t)move[k + 1]);
    sleeps(1000);
    ps_logf("interrupt %d, order %d, tick %u", interrupts, order, (unsigned)now);
    configASSERT(FAILS == 0);
    vPortEndScheduler();
}
static void longs(void *argument)
{
    (void)argument;
    for (;;) { /* it never sleeps: others come by the tick only, and not into its critical section */
        uint32_t begin;
        portENTER_CRITICAL();
        portENTER_CRITICAL();
        begin = now;
        ps_delay_us(1500);
        portEXIT_CRITICAL();
        late += now != begin;
        portEXIT_CRITICAL();
        ps_delay_us(300);
    }
}
static void returns(void *argument) { (void)argument; }
static void idle(void *argument) { (void)argument; for (;;) vApplicationIdleHook(); }
int main(void)
{
    make(urgent, 0), make(returns, 2), make(longs, 3), make(idle, 0);
    ps_on_line(0, 2, line, 0);
    portDISABLE_INTERRUPTS();
    vTaskSwitchContext();
    xPortStartScheduler();
    ps_logf("over, %d late", late);
    return 7;
}
"""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory, firmware):  # `firmware` skips where there is no compiler
    folder = tmp_path_factory.mktemp("tiny")
    (folder / "FreeRTOS.h").write_text(FREERTOS_H)
    (folder / "task.h").write_text("")
    (folder / "tiny.c").write_text(TINY)
    return folder


def run_tiny(folder: Path, fails: int, isolated: bool):
    board = Board(Stage("xy", chips=PCL240MK, visuals=False))
    flags = (f"-I{folder}", f"-DFAILS={fails}", "-Wall", "-Wextra", "-Werror")
    with NativeHost(folder / "tiny.c", board, platform="freertos", flags=flags, isolated=isolated) as host:
        code = host.run(timeout=1).code
    return code, host.log, str(board.trace)


def test_tasks_the_tick_and_an_interrupt_change_stacks_to_the_same_bits(tiny):
    first = run_tiny(tiny, 0, False)
    code, log, _ = first
    assert code == 7
    assert [text for _, text in log] == [
        "FreeRTOS: the task short has returned; a task ends by vTaskDelete(NULL)",
        "interrupt 1, order 1, tick 28", "over, 0 late",
    ]  # fmt: skip
    at = log[1][0]
    assert at == pytest.approx(0.005 + 30 / 1000, abs=0.004), "it preempts as soon as the section is over"
    assert run_tiny(tiny, 0, True) == first


def test_an_assertion_that_fails_ends_the_run_and_says_where(tiny):
    code, log, _ = run_tiny(tiny, 1, False)
    assert code == 1
    assert "FreeRTOS: an assertion does not hold, at " in log[2][1]
    assert "tiny.c:" in log[2][1]


def run_program(isolated: bool) -> tuple:
    """drive_and_watch.c on this machine."""
    stage = Stage("xy", chips=PCL240MK, visuals=False)
    board = Board(stage)
    kernel = [KERNEL / f"{name}.c" for name in ("tasks", "list", "queue")]
    sources = [*FIRMWARE_SOURCES, EXAMPLES / "hal/hal_pulsestage.c", *kernel]
    with NativeHost(sources, board, platform="freertos", flags=tuple(FOLDERS), isolated=isolated) as host:
        code = host.run(timeout=5).code
    return code, [text for _, text in host.log], str(board.trace), stage.data.qpos.tolist()


def run_on_cortex(program: Path) -> tuple:
    stage = Stage("xy", chips=PCL240MK, visuals=False)
    board = Board(stage)
    maps = ["0x40021000=0x300+0x40", "irq=6"]
    with TargetHost(program, board, mcu="cortex-m3", map=maps) as host:
        code = host.run(timeout=5).code
    return code, [text for _, text in host.log], str(board.trace), stage.data.qpos.tolist()


def check_log(printed_text: list[str]) -> None:
    assert [text for text in printed_text if "there" in text] == ["there at 2000", "there at 0"]
    assert printed_text[0] == "2000 pulses left"
    assert printed_text[-1] == "7 looks"


def test_a_missing_freertos_source_names_where_to_get_it(tiny):
    (tiny / "alone").mkdir()
    (tiny / "alone" / "app.c").write_text("int main(void) { return 0; }\n")
    with pytest.raises(
        CompileError, match=r"FreeRTOS\.h: it is in FreeRTOS' own sources, .* F/tasks\.c F/list\.c F/queue\.c"
    ):
        build(tiny / "alone" / "app.c", platform="freertos")


@needs_kernel
def test_freertos_itself_sleeps_and_wakes_by_interrupt(firmware):
    runs = [run_program(False), run_program(False), run_program(True)]
    assert runs[0][0] == 0
    check_log(runs[0][1])
    assert runs[0] == runs[1] == runs[2]


@needs_kernel
@pytest.mark.skipif(
    not supported_processors.has_unicorn(), reason=f"there is no {supported_processors.UNICORN_REQUIREMENT}"
)
@pytest.mark.skipif(shutil.which("arm-none-eabi-gcc") is None, reason="there is no arm-none-eabi-gcc")
def test_the_original_freertos_port_runs_on_a_cortex_m3(tmp_path):
    """SVC, PendSV, SysTick, BASEPRI and both stacks as FreeRTOS uses them."""
    port = KERNEL / "portable/GCC/ARM_CM3"
    kernel = [KERNEL / f"{name}.c" for name in ("tasks", "list", "queue")]
    sources = [
        *FIRMWARE_SOURCES,
        EXAMPLES / "hal/hal_cortexm3.c",
        *kernel,
        port / "port.c",
        KERNEL / "portable/MemMang/heap_4.c",
    ]
    options = "-mcpu=cortex-m3 -mthumb -Os -DHAL_FREERTOS -nostartfiles -Wl,-n".split()
    build_example = tmp_path / "drive_and_watch.elf"
    command = [
        "arm-none-eabi-gcc",
        *options,
        "-T",
        EXAMPLES / "hal/cortexm3.ld",
        *FOLDERS,
        f"-I{port}",
        *sources,
        "-o",
        build_example,
    ]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    first = run_on_cortex(build_example)
    assert first[0] == 0
    check_log(first[1])
    assert run_on_cortex(build_example) == first
