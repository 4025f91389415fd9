//! Recorder: every step to the flight log on the card.
//!
//! ```text
//! control ─► Recorder: blocks ─► queue in core-coupled RAM ─► keep, a task below control ─► FLIGHT.LOG, from where the last log ends
//! ```
//!
//! Control never waits: where the queue is full, for the card is slow, absent or full, a block is dropped, counted and told, and the
//! steps' numbers jump in the log. A card that is not there, or fails, is looked for again each second, and then a new log begins.
use core::convert::Infallible;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

use control_core::parameters::Parameters;
use cortex_m::singleton;
use embassy_time::{Duration, Instant, Timer};
use firmware::flight_log::{Block, Packer, Preamble};
use firmware::log_file::{Extent, FileError};
use firmware::record::WORDS;
use heapless::spsc::{Consumer, Producer, Queue};

use crate::board;
use crate::card::{CardError, Slot};

/// Blocks that may wait: half a second of flight, for a card may take half of that for one, and more to come up.
const WAITING: usize = 120;
/// The queue keeps one place free.
type Blocks = Queue<Block, { WAITING + 1 }>;

/// Not cleared at boot, and no DMA reaches them.
#[unsafe(link_section = ".ccm")]
static mut QUEUE: MaybeUninit<Blocks> = MaybeUninit::uninit();
#[unsafe(link_section = ".ccm")]
static mut PACKER: MaybeUninit<Packer> = MaybeUninit::uninit();
/// Blocks for which there was no room.
static DROPPED: AtomicU32 = AtomicU32::new(0);

/// Time after which a card that is not there, or has failed, is looked for again.
const RETRY: Duration = Duration::from_secs(1);
/// Time between two looks at an empty queue.
const LOOK: Duration = Duration::from_millis(50);
/// Time after which the card is told to keep what it has taken.
const COMMIT: Duration = Duration::from_secs(1);

/// Notes steps for the log. Control's.
pub(crate) struct Recorder {
    packer: &'static mut Packer,
    blocks: Producer<'static, Block>,
}

impl Recorder {
    /// Notes a step, by the words of its record.
    pub(crate) fn note(&mut self, record: &[u32; WORDS]) {
        self.packer.note(record, |full| {
            if self.blocks.enqueue(full.clone()).is_err() {
                DROPPED.fetch_add(1, Ordering::Relaxed);
            }
        });
    }
}

/// Both ends of the queue.
///
/// # Panics
/// If called twice.
pub(crate) fn queue() -> (Recorder, Consumer<'static, Block>) {
    singleton!(: () = ()).expect("called once");
    let (queue, packer) = (&raw mut QUEUE, &raw mut PACKER);
    // SAFETY: the first line lets nobody else come here.
    let (queue, packer) = unsafe { (&mut *queue, &mut *packer) };
    let (blocks, consumer) = queue.write(Queue::new()).split();
    (Recorder { packer: packer.write(Packer::new()), blocks }, consumer)
}

/// What flies.
pub(crate) struct Flown {
    pub(crate) parameters: Parameters,
    /// Whether it goes on after a reset in the air.
    pub(crate) resumed: bool,
}

/// Why the log is not kept.
enum Trouble {
    File(FileError<CardError>),
    Full,
}

impl From<CardError> for Trouble {
    fn from(error: CardError) -> Self {
        Self::File(error.into())
    }
}

/// What was said of it.
struct Said {
    trouble: &'static str,
    dropped: u32,
}

/// Keeps the log, for ever.
#[embassy_executor::task]
pub(crate) async fn keep(mut slot: Slot, flown: Flown, mut blocks: Consumer<'static, Block>) -> ! {
    let mut said = Said { trouble: "", dropped: 0 };
    loop {
        let Err(trouble) = log(&mut slot, &flown, &mut blocks, &mut said).await;
        let trouble = match trouble {
            Trouble::Full => "FLIGHT.LOG is full",
            Trouble::File(FileError::NoFile) => "the card has no FLIGHT.LOG",
            Trouble::File(FileError::NoFat) => "the card has no FAT32",
            Trouble::File(FileError::Card(CardError::Small)) => "the card is of less than 4 GB",
            Trouble::File(FileError::Card(CardError::Failing)) => "the card fails",
            Trouble::File(FileError::Card(CardError::Missing)) => "there is no card",
        };
        if !core::ptr::eq(trouble, said.trouble) {
            defmt::warn!("no flight log: {=str}", trouble);
            said.trouble = trouble;
        }
        Timer::after(RETRY).await;
    }
}

/// Keeps the log until something is wrong with the card.
async fn log(
    slot: &mut Slot,
    flown: &Flown,
    blocks: &mut Consumer<'static, Block>,
    said: &mut Said,
) -> Result<Infallible, Trouble> {
    slot.wake().await?;
    let file = Extent::find(slot).await.map_err(Trouble::File)?;
    let mut log = Log { next: file.end(slot).await?, slot, file, number: 0 };
    log.slot.start(file.first + log.next).await?;
    let Flown { parameters, resumed } = flown;
    let image = [env!("CARGO_PKG_VERSION"), env!("COMMIT")];
    let preamble = Preamble { image, board: board::NAME, parameters, resumed: *resumed };
    for block in preamble.blocks() {
        log.write(&block).await?;
    }
    defmt::info!("the flight log is in FLIGHT.LOG, block {=u32} of {=u32}", log.next, file.blocks);
    said.trouble = "";
    let mut commit = Instant::now() + COMMIT;
    loop {
        if let Some(block) = blocks.peek() {
            log.write(block).await?;
            blocks.dequeue();
        } else {
            Timer::after(LOOK).await;
        }
        if Instant::now() >= commit {
            log.commit().await?;
            commit = Instant::now() + COMMIT;
            let dropped = DROPPED.load(Ordering::Relaxed);
            if dropped != said.dropped {
                defmt::warn!("{=u32} blocks of the flight log are lost", dropped.wrapping_sub(said.dropped));
                said.dropped = dropped;
            }
        }
    }
}

/// A log that is being written.
struct Log<'a> {
    slot: &'a mut Slot,
    file: Extent,
    /// The next block: of the file, and of the log.
    next: u32,
    number: u32,
}

impl Log<'_> {
    async fn write(&mut self, block: &Block) -> Result<(), Trouble> {
        if self.next >= self.file.blocks {
            self.slot.stop().await?;
            return Err(Trouble::Full);
        }
        self.slot.write(&block.sealed(self.number)).await?;
        self.next += 1;
        self.number += 1;
        Ok(())
    }

    /// Lets the card keep what it has taken.
    async fn commit(&mut self) -> Result<(), Trouble> {
        self.slot.stop().await?;
        Ok(self.slot.start(self.file.first + self.next).await?)
    }
}
