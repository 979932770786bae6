//! 4000 pulses on a PCL-240MK at 300h, with an interrupt at their end.
//!
//!     rustc --edition 2024 -O --crate-type cdylib driver.rs -o driver.so && stage run driver.so --chips PCL240MK
#![deny(unsafe_code)]
#[allow(unsafe_code)]
mod pulsestage;

use core::ffi::c_void;
use core::sync::atomic::{AtomicBool, Ordering::Relaxed};
use pulsestage::{delay_us, in8, log, on_interrupt, out8};

static STOPPED: AtomicBool = AtomicBool::new(false);

struct Chip {
    port: u32,
}

impl Chip {
    fn command(&self, value: u8) {
        out8(self.port, value);
    }
    fn load(&self, number: u8, value: u32) {
        let [low, middle, high, _] = value.to_le_bytes();
        self.command(0x80 | number);
        for (offset, byte) in [(3, high), (2, middle), (1, low)] {
            out8(self.port + offset, byte);
        }
    }
    fn pulses_left(&self) -> u32 {
        u32::from_le_bytes([in8(self.port + 1), in8(self.port + 2), in8(self.port + 3), 0])
    }
}

const X: Chip = Chip { port: 0x300 };

extern "C" fn at_stop(_: *mut c_void) {
    X.command(0x08); // reset command: /INT is released
    STOPPED.store(true, Relaxed);
}

fn run() -> i32 {
    X.command(0x08);
    on_interrupt(Some(at_stop));
    for (number, value) in [4000, 50, 400, 400, 1500, 1500, 485, 30].into_iter().enumerate() {
        X.load(number as u8, value); // R0 to R7
    }
    X.command(0x44); // preset, towards plus
    X.command(0x35); // ramp to FH1, /INT at stop
    while !STOPPED.load(Relaxed) {
        delay_us(1000);
    }
    log(&format!("{} pulses are left", X.pulses_left()));
    0
}

#[allow(unsafe_code)]
mod entry {
    super::pulsestage::entry!(super::run);
}
