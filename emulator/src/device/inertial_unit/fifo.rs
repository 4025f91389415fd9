//! The FIFO of an ICM-42688-P: the newest 128 packets of 16 bytes, each read once.
//!
//! | byte | of a packet |
//! |------|-------------|
//! | 0    | 0x60: accelerometer and gyro, 16 bits; ODR as before, no time stamp |
//! | 1    | acceleration, x, y, z, big-endian |
//! | 7    | rate, the same |
//! | 13   | temperature, 25 °C being zero |
//! | 14   | time stamp, switched off |
//!
//! A packet is what the body did when it was sampled. The simulator tells of that once in four: between two times that it tells, the body
//! moves evenly, and only after the last does it hold.
//!
//! # Source
//! TDK DS-000347 rev 1.6, chapter 6 "FIFO".
use super::{Motion, counts};
use std::collections::VecDeque;

/// Bytes of a packet, and packets that there is room for.
pub(super) const PACKET: usize = 16;
pub(super) const PACKETS: usize = 2_048 / PACKET;
const HEADER: u8 = 0x60;
/// What an empty one answers: in a header, its first bit says so.
const EMPTY: u8 = 0xff;

#[derive(Clone, Copy, Debug)]
struct Packet {
    sampled_at: u64,
    bytes: [u8; PACKET],
}

/// What it holds.
#[derive(Debug, Default)]
pub(super) struct Fifo {
    packets: VecDeque<Packet>,
    /// Bytes of the first packet that were read.
    read: usize,
}

impl Fifo {
    /// A sample comes; whether it took the last room or the oldest's.
    pub(super) fn push(&mut self, motion: &Motion, now: u64) -> bool {
        if self.packets.len() == PACKETS {
            self.packets.pop_front();
            self.read = 0;
        }
        self.packets.push_back(Packet { sampled_at: now, bytes: encode(motion) });
        self.packets.len() == PACKETS
    }

    /// The simulator has told how the body moves at a time, having told of `before` last: what was sampled between is now known.
    pub(super) fn settle(&mut self, before: (u64, &Motion), told: (u64, &Motion)) {
        let span = told.0.saturating_sub(before.0) as f32;
        for packet in self.packets.iter_mut().rev().take_while(|packet| packet.sampled_at > before.0) {
            let part = ((packet.sampled_at - before.0) as f32 / span).min(1.0);
            packet.bytes = encode(&before.1.towards(told.1, part));
        }
    }

    /// Whole packets in bytes.
    pub(super) fn bytes(&self) -> u16 {
        (self.packets.len() * PACKET) as u16
    }

    pub(super) fn read(&mut self) -> u8 {
        let Some(packet) = self.packets.front() else { return EMPTY };
        let byte = packet.bytes[self.read];
        self.read += 1;
        if self.read == PACKET {
            self.read = 0;
            self.packets.pop_front();
        }
        byte
    }

    pub(super) fn flush(&mut self) {
        *self = Self::default();
    }
}

fn encode(motion: &Motion) -> [u8; PACKET] {
    let mut bytes = [0; PACKET];
    bytes[0] = HEADER;
    for (word, counts) in bytes[1..13].chunks_exact_mut(2).zip(counts(motion)) {
        word.copy_from_slice(&counts.to_be_bytes());
    }
    bytes
}
