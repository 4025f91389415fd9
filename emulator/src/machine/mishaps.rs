//! What befalls the board from outside: panics, parts that fail, power that is cut, flash and a station.
use super::Machine;
use super::wiring::{FLASH_BYTES, LOOP};
use crate::Failure;
use crate::board;
use crate::chip::{BORRSTF, PORRSTF};
use crate::device::inertial_unit::{Answers, Inertial, InertialUnit};
use crate::peripheral::flash::{Cut, FLASH_START};
use unicorn_engine::RegisterARM as R;

impl Machine {
    /// Lets the program panic where it is: as if the language had found an index beyond the end.
    ///
    /// - `function`: [`Image::panic`], or `_defmt_panic`, which is told nothing but who calls it.
    ///
    /// # Errors
    /// Never: the place beside the loop is flash.
    pub fn panic(&mut self, function: u32) -> Result<(), Failure> {
        // A `core::panic::Location`, as this toolchain lays it out: name, its length, line, column; and the name.
        let place = LOOP.0 - 32;
        let location: Vec<u8> =
            [place + 16, 8, 1, 1].into_iter().flat_map(u32::to_le_bytes).chain(*b"injected").collect();
        self.fill_flash(place, &location)?;
        self.close_here();
        // The index, the length, and where; called from there.
        for (register, value) in [(R::R0, 7), (R::R1, 4), (R::R2, place), (R::LR, place | 1), (R::PC, function | 1)] {
            self.cpu.set(register, value);
        }
        Ok(())
    }

    /// Lets the inertial unit answer something else than it has.
    fn spoil(&mut self, answers: Answers) {
        self.state.borrow_mut().chip.board.imu.answers = answers;
    }

    /// Each of the converter's next conversions never ends.
    pub fn lose_conversions(&mut self, count: u32) {
        self.state.borrow_mut().chip.board.conversions_lost = count;
    }

    /// The inertial unit's line to the chip stays at one level.
    pub fn short_inertial_unit(&mut self, high: bool) {
        self.spoil(Answers::Always(if high { u8::MAX } else { 0 }));
    }

    /// The inertial unit answers anything.
    pub fn garble_inertial_unit(&mut self) {
        self.spoil(Answers::Garbage);
    }

    /// Puts another inertial unit on the board, which is off; to be called before the image runs.
    pub fn solder(&mut self, part: Inertial) {
        self.state.borrow_mut().chip.board.imu = InertialUnit::new(part, board::CYCLES_US);
    }

    /// The satellite receiver refuses what it is told next but its speed, so many times.
    pub fn refuse_setup(&mut self, times: u32) {
        self.state.borrow_mut().chip.board.gnss.refusals = times;
    }

    /// From now on all that the core does takes so many percent of the cycles that it should: whatever it is that steals its time.
    pub fn slow_down(&mut self, percent: u32) {
        self.state.borrow_mut().slowness_percent = percent.into();
    }

    /// Cuts power now, and switches it on again.
    pub fn cut_power(&mut self) {
        self.state.borrow_mut().chip.reset = Some(PORRSTF | BORRSTF);
    }

    /// The supply drops so far that the chip starts anew, but RAM keeps what it holds.
    pub fn brown_out(&mut self) {
        self.state.borrow_mut().chip.reset = Some(BORRSTF);
    }

    /// Cuts power at a word programmed or a sector erased, and switches it on again.
    ///
    /// - `after`: how many of them are still done.
    /// - `within`: whether the next one is done in part, or not at all.
    pub fn cut_power_at(&mut self, after: u32, within: bool) {
        self.state.borrow_mut().chip.flash.cut = Some(Cut { after, within });
    }

    /// How often power has been off.
    pub fn power_cuts(&self) -> u32 {
        self.power_cuts
    }

    /// Writes to flash what somebody else has put there before.
    ///
    /// # Errors
    /// If it is no flash.
    pub fn fill_flash(&mut self, address: u32, bytes: &[u8]) -> Result<(), Failure> {
        let end = FLASH_START + FLASH_BYTES;
        if address < FLASH_START || bytes.len() > end.saturating_sub(address) as usize {
            return Err(Failure(format!("{} bytes at {address:#010x} are not flash", bytes.len())));
        }
        let written = self.cpu.unicorn.mem_write(u64::from(address), bytes);
        written.map_err(|_| Failure(format!("there is no flash at {address:#010x}")))
    }

    /// The station sends these bytes.
    pub fn hear_station(&mut self, bytes: &[u8]) {
        self.state.borrow_mut().chip.hear(board::STATION, bytes, board::STATION_BAUD);
    }

    /// What the image has told the station since the last call.
    pub fn told_station(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.state.borrow_mut().chip.usart[board::STATION].sent)
    }
}
