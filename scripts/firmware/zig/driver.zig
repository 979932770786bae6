//! A PCL-240MK at 300h is reset, and the line is noted that it is there.
//!
//!     zig build-lib -dynamic -O ReleaseSafe driver.zig && stage run libdriver.so --chips PCL240MK
const Bus = extern struct {
    abi: u32,
    size: u32,
    host: ?*anyopaque,
    request: *const fn (?*anyopaque, i32, i64, i64) callconv(.c) i64,
};

export const pulsestage_abi: u32 = 1;
export var pulsestage_bus: ?*Bus = null;

fn request(what: i32, a: i64, b: i64) i64 {
    const bus = pulsestage_bus.?;
    return bus.request(bus.host, what, a, b);
}
fn in8(port: u32) u8 {
    return @truncate(@as(u64, @bitCast(request(0, port, 0))));
}
fn out8(port: u32, value: u8) void {
    _ = request(1, port, value);
}
fn log(text: [*:0]const u8) void {
    _ = request(6, @bitCast(@intFromPtr(text)), 0);
}

export fn pulsestage_main() c_int {
    out8(0x300, 0x08);
    if (in8(0x300) & 0x40 != 0) return 1;
    log("it does not operate");
    return 0;
}
