//! Entry to and return from exception handlers.
//!
//! A frame of 26 words goes to the stack. The chip leaves out the FPU's 18 where the program, or the handler that is
//! interrupted, has not used it, and fills them only once the new handler does (lazy stacking). Here they are always there, and
//! filled at once: the FPU counts as used from the start. Unicorn does not tell for sure whether it was: where the first of
//! several of its instructions in a block is skipped by an IT, the others run without setting FPCA. Only the main stack is modelled.
//!
//! # Source
//! ARMv7-M Architecture Reference Manual, B1.5.6 "Exception entry behavior" and B1.5.8 "Exception return behavior".
use crate::Failure;
use crate::machine::Cpu;
use crate::nvic::HARD_FAULT;
use unicorn_engine::RegisterARM as R;

/// Registers of the basic frame, in its order.
const BASIC: [R; 7] = [R::R0, R::R1, R::R2, R::R3, R::R12, R::LR, R::PC];
/// S0 to S15, in pairs.
const FPU: [R; 8] = [R::D0, R::D1, R::D2, R::D3, R::D4, R::D5, R::D6, R::D7];
/// Bytes of the frame.
const FRAME_BYTES: u32 = 104;
/// CONTROL: the process stack is used; the FPU has been used.
const SPSEL: u32 = 2;
pub(crate) const FPCA: u32 = 4;
/// xPSR: code is Thumb; the stack was not aligned.
const THUMB: u32 = 1 << 24;
const PADDED: u32 = 1 << 9;
/// EXC_RETURN: back to a handler, to the program; the FPU's part is on the stack.
const TO_HANDLER: u32 = 0xffff_ffe1;
const TO_THREAD: u32 = 0xffff_ffe9;

/// Cycles from the interrupt to the handler's first instruction, and back.
pub(crate) const ENTRY_CYCLES: u64 = 12;

/// Saves the state and goes to the handler at `vector`; `within` is the exception that was running, or 0.
///
/// False if there is no memory where the stack points, and nothing was done. HardFault is entered all the same: its handler finds
/// a stack pointer to nowhere.
pub(crate) fn enter(cpu: &mut Cpu, exception: u32, within: u32, vector: u32) -> Result<bool, Failure> {
    if cpu.register(R::CONTROL) & SPSEL != 0 {
        return Err(Failure("the program uses the process stack, which is not modelled".to_owned()));
    }
    let stack = cpu.register(R::SP);
    let frame = stack.wrapping_sub(FRAME_BYTES) & !4;

    let mut words: Vec<u32> = BASIC.iter().map(|&register| cpu.register(register)).collect();
    words[6] &= !1;
    let padded = if stack & 4 == 0 { 0 } else { PADDED };
    words.push(cpu.register(R::XPSR) & !PADDED & !0x1ff | within | THUMB | padded);
    for pair in FPU {
        let pair = cpu.wide(pair);
        words.extend([pair as u32, (pair >> 32) as u32]);
    }
    words.extend([cpu.register(R::FPSCR), 0]);
    if cpu.store(frame, &words).is_err() && exception != HARD_FAULT {
        return Ok(false);
    }

    cpu.set(R::SP, frame);
    cpu.set(R::LR, if within == 0 { TO_THREAD } else { TO_HANDLER });
    // FPDSCR, which the image leaves as it is.
    cpu.set(R::FPSCR, 0);
    cpu.set(R::IPSR, exception);
    cpu.set(R::PC, vector | 1);
    Ok(true)
}

/// Takes the state back that `exc_return` speaks of; `into` is the exception that goes on, or 0.
pub(crate) fn leave(cpu: &mut Cpu, exc_return: u32, into: u32) -> Result<(), Failure> {
    let expected = if into == 0 { TO_THREAD } else { TO_HANDLER };
    if exc_return != expected {
        return Err(Failure(format!("exception return to {exc_return:#010x} where {expected:#010x} is meant")));
    }
    let frame = cpu.register(R::SP);
    let words = cpu.load(frame, FRAME_BYTES as usize / 4)?;
    let xpsr = words[7];
    for (register, &word) in BASIC.iter().zip(&words).take(6) {
        cpu.set(*register, word);
    }
    cpu.set(R::SP, frame + FRAME_BYTES + if xpsr & PADDED == 0 { 0 } else { 4 });
    for (n, pair) in FPU.into_iter().enumerate() {
        cpu.set_wide(pair, u64::from(words[8 + 2 * n]) | u64::from(words[9 + 2 * n]) << 32);
    }
    cpu.set(R::FPSCR, words[24]);
    cpu.set(R::IPSR, into);
    cpu.set(R::XPSR, xpsr & !0x1ff | into);
    cpu.set(R::PC, words[6] | 1);
    Ok(())
}
