//! What a block of Thumb code costs, by the class of its instructions.
//!
//! | class                        | cycles        | manual says                       |
//! |------------------------------|---------------|-----------------------------------|
//! | arithmetic, moves, multiply  | 1             | 1                                 |
//! | load, store                  | 2             | 2, or 1 when pipelined or buffered|
//! | load or store of n registers | 1 + n         | 1 + n                             |
//! | branch taken                 | 1 + 3         | 1 + 1 to 3, by alignment          |
//! | integer divide               | 12            | 2 to 12                           |
//! | VDIV, VSQRT                  | 14            | 14                                |
//! | VMLA, VFMA and kin           | 3             | 3                                 |
//! | barriers, MSR, CPS           | 3             | 1 + pipeline                      |
//!
//! Where the manual gives a range the top is taken: the model errs on the late side. Wait states of flash are
//! `flash_cache`'s, those of the peripheral buses `bus`'s.
//!
//! # Source
//! Cortex-M4 Technical Reference Manual (DDI 0439), 3.3 "Instruction set summary" and 7.2.3 "FPU instruction set".

/// Cycles to refill the pipeline after a branch.
pub(crate) const REFILL: u64 = 3;

/// A stretch of code that runs from its first instruction to its last.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    /// First address after it.
    pub(crate) end: u32,
    /// Instructions.
    pub(crate) instructions: u32,
    /// Cycles, without flash wait states and without refills.
    pub(crate) cycles: u32,
    /// Addresses of the constants it loads relative to the program counter.
    pub(crate) literals: Vec<u32>,
    /// Whether it has a SEV.
    pub(crate) sends_event: bool,
}

/// Costs of one instruction.
struct Cost {
    cycles: u32,
    literal: Option<u32>,
}

impl Block {
    /// Decodes the code at `address`.
    pub(crate) fn decode(address: u32, code: &[u8]) -> Self {
        let halves: Vec<u32> = code.chunks_exact(2).map(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))).collect();
        let mut block = Self {
            end: address + code.len() as u32,
            instructions: 0,
            cycles: 0,
            literals: Vec::new(),
            sends_event: false,
        };
        let mut at = 0;
        while let Some(&first) = halves.get(at) {
            let pc = address + 2 * at as u32 + 4;
            let wide = first >> 11 > 0b11100;
            let cost = if wide {
                wide_cost(first, halves.get(at + 1).copied().unwrap_or(0), pc)
            } else {
                narrow_cost(first, pc)
            };
            block.instructions += 1;
            block.cycles += cost.cycles;
            block.literals.extend(cost.literal);
            block.sends_event |= first == 0xbf40;
            at += 1 + usize::from(wide);
        }
        block
    }
}

fn plain(cycles: u32) -> Cost {
    Cost { cycles, literal: None }
}

fn narrow_cost(op: u32, pc: u32) -> Cost {
    match op >> 11 {
        0b01001 => Cost { cycles: 2, literal: Some((pc & !3) + 4 * (op & 0xff)) },
        0b01010..=0b10011 => plain(2),
        // PUSH and POP, with LR or PC as one more.
        0b10110 | 0b10111 if op & 0x0600 == 0x0400 => plain(1 + (op & 0x1ff).count_ones()),
        // CPS.
        0b10110 if op & 0xffe0 == 0xb660 => plain(3),
        0b11000 | 0b11001 => plain(1 + (op & 0xff).count_ones()),
        _ => plain(1),
    }
}

fn wide_cost(first: u32, second: u32, pc: u32) -> Cost {
    let op = first << 16 | second;
    match first >> 9 & 0x7f {
        // LDM, STM; LDRD, STRD, exclusive, table branch.
        0b111_0100 if first & 0x40 == 0 => plain(1 + second.count_ones()),
        0b111_0100 => plain(3),
        // Coprocessor: the FPU.
        0b111_0110 | 0b111_0111 => fpu_cost(op, pc),
        // Loads and stores of one register.
        0b111_1100 if first & 0x7f == 0x5f => {
            let offset = second & 0xfff;
            let up = first & 0x80 != 0;
            Cost { cycles: 2, literal: Some(if up { (pc & !3) + offset } else { (pc & !3) - offset }) }
        }
        0b111_1100 => plain(2),
        // Divides are 1111 1011 10x1.
        0b111_1101 if first & 0xffd0 == 0xfb90 => plain(12),
        // Barriers, MSR, MRS, hints: 1111 0011 1xxx, which are no branches.
        0b111_1001 if first & 0xff80 == 0xf380 && second & 0xd000 == 0x8000 => plain(3),
        _ => plain(1),
    }
}

fn fpu_cost(op: u32, pc: u32) -> Cost {
    if op >> 25 & 1 == 0 {
        let words = op & 0xff;
        // VLDR and VSTR have P = 1 and W = 0; two registers at once are moves.
        return if op >> 21 & 0b1001 == 0b1000 {
            let literal = (op >> 16 & 0x1f == 0x1f)
                .then(|| if op >> 23 & 1 == 1 { (pc & !3) + 4 * words } else { (pc & !3) - 4 * words });
            Cost { cycles: 2, literal }
        } else if op >> 21 & 0xf == 0b0010 {
            plain(2)
        } else {
            plain(1 + words)
        };
    }
    if op >> 4 & 1 == 1 {
        // A move between a core and an FPU register.
        return plain(1);
    }
    let (kind, other) = (op >> 20 & 0b1011, op >> 16 & 0xf);
    match kind {
        0b1000 => plain(14),
        0b0000 | 0b0001 | 0b1001 | 0b1010 => plain(3),
        // VSQRT.
        0b1011 if other == 1 && op >> 6 & 3 == 0b11 => plain(14),
        _ => plain(1),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn decode(halves: &[u16]) -> Block {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        Block::decode(0x0800_0100, &code)
    }

    #[test]
    fn each_class_costs_what_the_manual_says() {
        for (why, code, cycles) in [
            ("adds r0, r1", &[0x1840][..], 1),
            ("ldr r0, [r1]", &[0x6808], 2),
            ("str r0, [sp, #4]", &[0x9001], 2),
            ("push {r4, r5, lr}", &[0xb530], 4),
            ("pop {r4, pc}", &[0xbd10], 3),
            ("stm r0!, {r1, r2}", &[0xc006], 3),
            ("cpsid i", &[0xb672], 3),
            ("udiv r0, r1, r2", &[0xfbb1, 0xf0f2], 12),
            ("sdiv r0, r1, r2", &[0xfb91, 0xf0f2], 12),
            ("mul r0, r1, r2", &[0xfb01, 0xf002], 1),
            ("ldr.w r0, [r1, #4]", &[0xf8d1, 0x0004], 2),
            ("ldrd r0, r1, [r2]", &[0xe9d2, 0x0100], 3),
            ("push.w {r4-r9, lr}", &[0xe92d, 0x43f0], 8),
            ("dsb", &[0xf3bf, 0x8f4f], 3),
            ("bl", &[0xf000, 0xf800], 1),
            ("vadd.f32 s0, s0, s1", &[0xee30, 0x0a20], 1),
            ("vmul.f32 s0, s0, s1", &[0xee20, 0x0a20], 1),
            ("vmla.f32 s0, s0, s1", &[0xee00, 0x0a20], 3),
            ("vfma.f32 s0, s0, s1", &[0xeea0, 0x0a20], 3),
            ("vdiv.f32 s0, s0, s1", &[0xee80, 0x0a20], 14),
            ("vsqrt.f32 s0, s1", &[0xeeb1, 0x0ae0], 14),
            ("vneg.f32 s0, s1", &[0xeeb1, 0x0a60], 1),
            ("vmov s0, r0", &[0xee00, 0x0a10], 1),
            ("vldr s0, [r0]", &[0xed90, 0x0a00], 2),
            ("vpush {s16-s19}", &[0xed2d, 0x8a04], 5),
        ] {
            let block = decode(code);
            assert_eq!((block.instructions, block.cycles), (1, cycles), "{why}");
        }
    }

    #[test]
    fn constants_are_found_relative_to_the_aligned_program_counter() {
        assert_eq!(decode(&[0x4801]).literals, [0x0800_0108]);
        assert_eq!(decode(&[0xbf00, 0x4801]).literals, [0x0800_0108]);
        assert_eq!(decode(&[0xf8df, 0x0010]).literals, [0x0800_0114]);
        assert_eq!(decode(&[0xed9f, 0x0a02]).literals, [0x0800_010c]);
    }

    #[test]
    fn an_event_that_is_sent_is_seen() {
        assert!(decode(&[0xbf00, 0xbf40]).sends_event);
        assert!(!decode(&[0xbf20]).sends_event);
    }
}
