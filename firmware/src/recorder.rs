//! Recorder: every step to the flight log, on a card or in a flash chip (`medium.rs`).
//!
//! ```text
//! control ─► Recorder: blocks ─► queue in RAM of its own ─► keep, a task below control ─► the medium, from where the last log ends
//!                                                             station: size, blocks, erase ◄─┘ of a flash chip
//! ```
//!
//! Control never waits: where the queue is full, for the medium is slow, absent or full, a block is dropped, counted and told, and the
//! steps' numbers jump in the log. A medium that is not there, or fails, is looked for again each second, and then a new log begins.
//! What the station wishes comes after what waits to be written, and ends where a motor may turn.
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicU32, Ordering};

use control_core::parameters::Parameters;
use cortex_m::singleton;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::{Duration, Instant, with_timeout};
use firmware::flight_log::{BLOCK_BYTES, Block, Packer, Preamble, Resumed};
use firmware::log_file::Blocks as _;
use firmware::record::WORDS;
use flight_link::{FromBoard, LogPart, LogRefusal, LogSize, LogWish, PART_BYTES};
use heapless::spsc::{Consumer, Producer, Queue};

use crate::board;
use crate::line::Line;
use crate::log_bus::LogBus;
use crate::log_flash::SECTOR_BLOCKS;
use crate::medium::{Medium, Trouble};
use crate::station;

/// Blocks that may wait: half a second of flight, for a card may take half of that for one, and more to come up.
const WAITING: usize = 120;
/// The queue keeps one place free.
type Blocks = Queue<Block, { WAITING + 1 }>;

/// Not cleared at boot, and no DMA reaches them.
#[unsafe(link_section = ".log")]
static mut QUEUE: MaybeUninit<Blocks> = MaybeUninit::uninit();
#[unsafe(link_section = ".log")]
static mut PACKER: MaybeUninit<Packer> = MaybeUninit::uninit();
#[unsafe(link_section = ".log")]
static mut RESUMED: MaybeUninit<Resumed> = MaybeUninit::uninit();
/// What the station wishes, and on which line it listens.
pub(crate) static WISH: Signal<CriticalSectionRawMutex, (&'static Line, LogWish)> = Signal::new();
/// Blocks for which there was no room.
static DROPPED: AtomicU32 = AtomicU32::new(0);

/// Time after which a medium that is not there, or has failed, is looked for again.
const RETRY: Duration = Duration::from_secs(1);
/// Time between two looks at an empty queue.
const LOOK: Duration = Duration::from_millis(50);
/// Time after which a card is told to keep what it has taken, and lost blocks are told.
const COMMIT: Duration = Duration::from_secs(1);

/// Parts of a block that are told at once.
const PARTS: u32 = (BLOCK_BYTES / PART_BYTES) as u32;

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

/// Both ends of the queue, and where what the flight goes on from waits for the preamble.
///
/// # Panics
/// If called twice.
pub(crate) fn queue(resumed: Option<Resumed>) -> (Recorder, Consumer<'static, Block>, Option<&'static Resumed>) {
    singleton!(: () = ()).expect("called once");
    let (queue, packer, place) = (&raw mut QUEUE, &raw mut PACKER, &raw mut RESUMED);
    // SAFETY: the first line lets nobody else come here.
    let (queue, packer, place) = unsafe { (&mut *queue, &mut *packer, &mut *place) };
    let (blocks, consumer) = queue.write(Queue::new()).split();
    let resumed = resumed.map(|resumed| &*place.write(resumed));
    (Recorder { packer: packer.write(Packer::new()), blocks }, consumer, resumed)
}

/// What flies.
pub(crate) struct Flown {
    pub(crate) parameters: Parameters,
    /// What it goes on from after a reset in the air.
    pub(crate) resumed: Option<&'static Resumed>,
}

/// What was said of it.
struct Said {
    trouble: &'static str,
    dropped: u32,
}

impl Said {
    /// Says why there is no log, once.
    fn say(&mut self, trouble: &'static str) {
        if !core::ptr::eq(trouble, self.trouble) {
            defmt::warn!("no flight log: {=str}", trouble);
            self.trouble = trouble;
        }
    }

    /// Says how many blocks were lost since this was said last.
    fn count(&mut self) {
        let dropped = DROPPED.load(Ordering::Relaxed);
        if dropped != self.dropped {
            defmt::warn!("{=u32} blocks of the flight log are lost", dropped.wrapping_sub(self.dropped));
            self.dropped = dropped;
        }
    }
}

/// Keeps the log, for ever.
#[embassy_executor::task]
pub(crate) async fn keep(mut bus: LogBus, flown: Flown, mut blocks: Consumer<'static, Block>) -> ! {
    let (mut said, mut empty) = (Said { trouble: "", dropped: 0 }, false);
    loop {
        let Err(trouble) = log(&mut bus, &mut empty, &flown, &mut blocks, &mut said).await else { continue };
        said.say(trouble.text());
        if let Ok((line, _)) = with_timeout(RETRY, WISH.wait()).await {
            line.say(&FromBoard::LogRefused(LogRefusal::Absent));
        }
    }
}

/// Keeps the log until it is erased, or something is wrong with its medium.
async fn log(
    bus: &mut LogBus,
    empty: &mut bool,
    flown: &Flown,
    blocks: &mut Consumer<'static, Block>,
    said: &mut Said,
) -> Result<(), Trouble> {
    let (medium, next) = Medium::find(bus, empty).await?;
    let mut log = Log { medium, first: next, next, telling: None };
    let Flown { parameters, resumed } = flown;
    let image = [env!("CARGO_PKG_VERSION"), env!("COMMIT")];
    let preamble = Preamble { image, board: board::NAME, parameters, resumed: *resumed };
    for block in preamble.blocks() {
        log.write(&block).await?;
    }
    if log.next > log.first {
        log.medium.check(log.first).await?;
        let (place, next, room) = (log.medium.place(), log.next, log.medium.blocks());
        defmt::info!("the flight log is in {=str}, block {=u32} of {=u32}", place, next, room);
        said.trouble = "";
    }
    let mut commit = Instant::now() + COMMIT;
    loop {
        if let Some(wish) = WISH.try_take()
            && log.answer(wish).await?
        {
            return Ok(());
        }
        if log.is_full() {
            log.medium.end().await?;
            said.say("the log flash is full, or has what somebody else wrote");
        } else if let Some(block) = blocks.peek() {
            log.write(block).await?;
            blocks.dequeue();
        }
        if Instant::now() >= commit {
            log.medium.commit(log.next).await?;
            commit = Instant::now() + COMMIT;
            said.count();
        }
        if log.is_full() || !blocks.ready() {
            if log.telling.is_some() {
                log.tell().await?;
            } else if let Ok(wish) = with_timeout(LOOK, WISH.wait()).await {
                WISH.signal(wish);
            }
        }
    }
}

/// Blocks that are being told.
struct Telling {
    line: &'static Line,
    next: u32,
    end: u32,
}

/// A log that is being written.
struct Log<'a> {
    medium: Medium<'a>,
    /// Its first block, and the next one, of the medium.
    first: u32,
    next: u32,
    telling: Option<Telling>,
}

impl Log<'_> {
    fn is_full(&self) -> bool {
        self.next >= self.medium.blocks()
    }

    /// Writes a block, if there is room.
    async fn write(&mut self, block: &Block) -> Result<(), Trouble> {
        if self.is_full() {
            return self.medium.end().await;
        }
        self.medium.write(self.next, &block.sealed(self.next - self.first)).await?;
        self.next += 1;
        Ok(())
    }

    /// Does what the station wishes; whether the log begins anew then.
    async fn answer(&mut self, (line, wish): (&'static Line, LogWish)) -> Result<bool, Trouble> {
        let Medium::Flash(flash) = &mut self.medium else {
            line.say(&FromBoard::LogRefused(LogRefusal::Absent));
            return Ok(false);
        };
        let size = LogSize { used: self.next, room: flash.blocks, running: self.first };
        match wish {
            LogWish::Size => line.say(&FromBoard::LogSize(size)),
            LogWish::Read(first, count) => {
                self.telling =
                    Some(Telling { line, next: first, end: self.next.min(first.saturating_add(count.into())) });
            }
            LogWish::Erase => {
                // From its end on, so that power that fails leaves logs and then nothing, as it is searched for.
                let mut sectors = self.next.div_ceil(SECTOR_BLOCKS);
                while sectors > 0 && !station::runs() {
                    sectors -= 1;
                    let used = sectors * SECTOR_BLOCKS;
                    flash.erase(used).await?;
                    line.say(&FromBoard::LogSize(LogSize { used, running: used, ..size }));
                }
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Tells the next block that is wished.
    async fn tell(&mut self) -> Result<(), Trouble> {
        let (Medium::Flash(flash), Some(telling)) = (&mut self.medium, &mut self.telling) else { return Ok(()) };
        let mut bytes = [0; BLOCK_BYTES];
        let mut heard = telling.next < telling.end && !station::runs();
        if heard {
            flash.read(telling.next, &mut bytes).await?;
        }
        for (number, part) in (telling.next * PARTS..).zip(bytes.as_chunks::<PART_BYTES>().0) {
            let rows = part.as_chunks().0.first_chunk().copied().unwrap_or_default();
            heard = heard && telling.line.say_in_turn(&FromBoard::LogPart(LogPart { number, bytes: rows })).await;
        }
        telling.next += 1;
        if !heard {
            self.telling = None;
        }
        Ok(())
    }
}
