//! The bus of an emulated board, without `unsafe` for who uses it: the Rust side of pulsestage.h.
//!
//! `mod pulsestage;` in a crate of type cdylib, and `pulsestage::entry!(run);` with `fn run() -> i32`. Editions 2021 (Rust 1.82) and 2024.
#![allow(non_upper_case_globals, dead_code)]

use core::ffi::{CStr, c_void};
use core::ptr::null_mut;
use core::sync::atomic::{AtomicPtr, Ordering::Relaxed};
use std::ffi::CString;

#[repr(C)]
pub struct Bus {
    abi: u32,
    size: u32,
    host: *mut c_void,
    request: extern "C" fn(*mut c_void, i32, i64, i64) -> i64,
}

#[unsafe(no_mangle)]
pub static pulsestage_abi: u32 = 1;
/// Filled in before the entry is called: an AtomicPtr is a pointer in memory.
#[unsafe(no_mangle)]
pub static pulsestage_bus: AtomicPtr<Bus> = AtomicPtr::new(null_mut());

fn request(what: i32, a: i64, b: i64) -> i64 {
    let bus = pulsestage_bus.load(Relaxed);
    assert!(!bus.is_null(), "the bus is there from the entry on");
    // SAFETY: the host fills in the pointer before it calls the entry, and what it points to stays
    unsafe { ((*bus).request)((*bus).host, what, a, b) }
}

pub fn in8(port: u32) -> u8 {
    request(0, port.into(), 0) as u8
}
pub fn out8(port: u32, value: u8) {
    request(1, port.into(), value.into());
}
pub fn in16(port: u32) -> u16 {
    request(2, port.into(), 0) as u16
}
pub fn out16(port: u32, value: u16) {
    request(3, port.into(), value.into());
}
pub fn delay_us(us: u32) {
    request(4, us.into(), 0);
}
pub fn micros() -> u64 {
    request(5, 0, 0) as u64
}
pub fn log_c(text: &CStr) {
    request(6, text.as_ptr() as i64, 0);
}
/// A line for the log of the run; what is behind a NUL is cut off.
pub fn log(text: &str) {
    let text = text.split('\0').next().unwrap_or("");
    log_c(&CString::new(text).unwrap_or_default());
}
/// Calls `hook` while the interrupt line is asserted; None: no longer.
pub fn on_interrupt(hook: Option<extern "C" fn(*mut c_void)>) {
    request(7, hook.map_or(0, |f| f as usize as i64), 0);
}
pub fn interrupt_line() -> bool {
    request(8, 0, 0) != 0
}

/// Where the firmware begins: a function without arguments that returns the result of the run.
#[macro_export]
macro_rules! entry {
    ($run:path) => {
        #[unsafe(no_mangle)]
        pub extern "C" fn pulsestage_main() -> i32 {
            $run()
        }
    };
}
pub use entry;
