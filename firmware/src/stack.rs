//! How deep the stack has been. `cortex-m-rt` paints it at start.

const PAINT: u32 = 0xcccc_cccc;

unsafe extern "C" {
    static _stack_start: u32;
    static _stack_end: u32;
}

/// Bytes between the end of static memory and the end of RAM.
pub fn size() -> u32 {
    (&raw const _stack_start as u32).wrapping_sub(&raw const _stack_end as u32)
}

/// Most bytes that were ever in use.
pub fn peak() -> u32 {
    let start = &raw const _stack_start as usize;
    let mut at = &raw const _stack_end as usize;
    // SAFETY: aligned words inside the stack's memory, which is RAM and initialised by the paint.
    while at < start && unsafe { core::ptr::read_volatile(at as *const u32) } == PAINT {
        at += 4;
    }
    (start - at) as u32
}
