//! The panics that may stay in an image's control task and interrupts, and the calls through pointers, each with its reason.

/// A panic that may stay: how its place and its kind or message begin, and why it is not taken. Where no place is at hand it is the function.
pub(super) struct Allowed {
    pub(super) place: &'static str,
    pub(super) panic: &'static str,
    pub(super) why: &'static str,
}

const fn allowed(place: &'static str, panic: &'static str, why: &'static str) -> Allowed {
    Allowed { place, panic, why }
}

/// Every one.
pub(super) const ALLOWED: [Allowed; 26] = [
    allowed(
        "",
        "core::panicking::panic_const::panic_const_async_fn_resumed",
        "something that has ended is polled again: the executor polls no task that has ended, and await nothing",
    ),
    allowed(
        "defmt-rtt/src/lib.rs",
        "core::panicking::panic_fmt",
        "a log line within another: lines are written with interrupts masked, and none formats what logs",
    ),
    allowed(
        "embassy-executor/src/raw/waker.rs",
        "core::panicking::panic_fmt",
        "a waker that is not the executor's: all are",
    ),
    allowed("embassy-futures/src/join.rs", "", "the result of a future taken twice: a join ends once"),
    allowed(
        "embassy-stm32",
        "panicked at 'DMA: error on",
        "a transfer to where its stream does not reach: buffers lie in RAM that it does",
    ),
    allowed(
        "embassy-stm32",
        "panicked at 'You are trying to reach a frequency higher",
        "a bus that is to be faster than its clock: no board's clock is so slow, and the first setting would fail, before a motor can turn",
    ),
    allowed(
        "embassy-stm32",
        "panicked at 'assertion failed: `(left == right)`'",
        "a transfer as long one way as the other is not: it is one buffer",
    ),
    allowed(
        "embassy-stm32",
        "panicked at 'assertion failed: mem_len",
        "a transfer of nothing, or of more than 64 KiB: the lengths of bursts are constants",
    ),
    allowed("embassy-stm32", "panicked at 'assertion failed: ndtr", "the same"),
    allowed("embassy-stm32", "panicked at 'MDMA", "the master DMA of the STM32H7, which nothing uses"),
    allowed("embassy-stm32", "panicked at 'assertion failed: ! options.circular", "the same"),
    allowed(
        "embassy-stm32",
        "panicked at 'assertion failed: start_ch_index",
        "channels in the wrong order: the first frame would fail, before a motor can turn",
    ),
    allowed(
        "embassy-stm32",
        "panicked at 'attempted to use peripheral",
        "a bus without a clock: the first setting would fail",
    ),
    allowed(
        "embassy-stm32",
        "panicked at 'peripheral '{}' is configured",
        "a bus without a clock: the first setting would fail",
    ),
    allowed(
        "embassy-stm32",
        "panicked at 'unwrap failed: self.regs_gp32_unchecked()",
        "a timer's period of more than 16 bits: the boards set none",
    ),
    allowed(
        "embassy-stm32/src/dma/",
        "core::panicking::panic_bounds_check",
        "a stream beyond the chip's: types fix them",
    ),
    allowed(
        "embassy-stm32/src/dma/dma_bdma.rs",
        "core::panicking::panic_fmt",
        "a burst of a length that no stream has: none is asked for",
    ),
    allowed(
        "embassy-stm32/src/exti/mod.rs",
        "core::panicking::panic_bounds_check",
        "a line beyond the sixteenth: types fix them",
    ),
    allowed(
        "embassy-stm32/src/spi/mod.rs",
        "core::option::unwrap_failed",
        "a bus without its streams: it is made with both",
    ),
    allowed(
        "embassy-stm32/src/spi/mod.rs",
        "core::panicking::panic_const::panic_const_div_by_zero",
        "a bus of 0 Hz: none is set",
    ),
    allowed(
        "embassy-stm32/src/time_driver/gp16.rs",
        "core::cell::panic_already_borrowed",
        "the clock's queue taken twice: it is taken with interrupts masked, and given back before",
    ),
    allowed(
        "embassy-stm32/src/usart/mod.rs",
        "core::option::unwrap_failed",
        "a line without its stream: it is made with one",
    ),
    allowed(
        "embassy-time/src/instant.rs",
        "core::option::expect_failed",
        "64 bits of microseconds overflow after 584,000 years",
    ),
    allowed(
        "embassy-usb-synopsys-otg",
        "",
        "an endpoint that the port does not have, or a set-up packet that is not eight bytes: the port itself lets none pass",
    ),
    allowed(
        "heapless/src/spsc.rs",
        "core::panicking::panic_const::panic_const_rem_by_zero",
        "a queue without a place: it has five",
    ),
    allowed("stm32-metapac/src/", "core::panicking::panic", "a register's field beyond its last: types fix them"),
];

/// Functions that call through pointers, and where these lead.
pub(super) const INDIRECT: [(&str, &str); 9] = [
    ("FMC", "the control task: a root of its own"),
    ("FSMC", "the same"),
    ("control_core::arming::Facts::failing", "the conditions of the table of checks: roots of their own"),
    ("control_core::autopilot::Autopilot::watch", "the conditions of the failsafe table: roots of their own"),
    ("_$LT$embassy_stm32..dma..dma_bdma..Transfer", "wakers: the executor's"),
    ("_embassy_time_schedule_wake", "wakers: the executor's"),
    ("embassy_executor::raw::TaskStorage", "wakers: the executor's"),
    ("embassy_time_queue_utils::Queue::next_expiration", "wakers: the executor's"),
    ("embassy_sync::waitqueue::atomic_waker::AtomicWaker", "wakers: the executor's"),
];
