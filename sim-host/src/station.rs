//! Station: speaks with a board over its line, in the records of `flight-link`.
//!
//! The line is a serial port, of which USB is one, or `tcp:HOST:PORT`, where the emulator serves. Every question has an
//! answer; none within [`PATIENCE`] is an error. In between the board says how it is, ten times a second.
use flight_link::{
    Decoder, FRAME_BYTES_MAX, FromBoard, Order, Outcome, ParameterName, ToBoard, VERSION, Verdict, encode,
};
use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::time::{Duration, Instant};

mod flight_log;

/// How long an answer may take.
pub const PATIENCE: Duration = Duration::from_secs(1);
/// How long a board may say nothing of itself, which it does ten times a second, before it counts as gone.
pub const LOST: Duration = Duration::from_secs(3);
/// How long a restart may take, with two sectors of flash erased on the way.
const RESTART_PATIENCE: Duration = Duration::from_secs(10);
/// How often the station gives a sign of life while a rotor may turn.
const LIFE: Duration = Duration::from_millis(100);
/// How long a look at the line waits for bytes.
const LOOK: Duration = Duration::from_millis(20);

/// Why the board was not asked, or did not do it.
#[derive(Debug, thiserror::Error)]
pub enum StationError {
    /// There is no such port.
    #[error("--port = {port}: cannot be opened: {why}; {there}")]
    Port {
        /// Its name.
        port: String,
        /// Why not.
        why: String,
        /// Which ports there are.
        there: String,
    },
    /// The line has broken.
    #[error("the line to the board has broken: {0}")]
    Broken(#[from] io::Error),
    /// It has fallen silent.
    #[error("the board says nothing any more")]
    Lost,
    /// Nothing was answered to a question.
    #[error("no answer within {} s: is the board switched on, and --baud the speed of its port?", PATIENCE.as_secs())]
    Silent,
    /// The board's program is of another time.
    #[error("the board speaks version {0} of the records, this program version {VERSION}: one of them is too old")]
    Version(u8),
    /// The board does not know a parameter of this name.
    #[error("{0}: the board has no parameter of this name")]
    Unknown(String),
    /// The board's range does not have the value.
    #[error("{0}: the board refuses this value: it is not in its range")]
    OutOfRange(String),
    /// It is armed.
    #[error("refused: not while it is armed or a rotor turns")]
    Armed,
    /// An order that no board obeys.
    #[error("refused: the board allows no such rotor, throttle or time")]
    BadOrder,
    /// The board's control loop does not run.
    #[error("refused: the board's control loop does not run; its log says why")]
    Unheard,
    /// No log can be had over the line.
    #[error("refused: {0}")]
    Log(&'static str),
    /// The flash is worn out.
    #[error("{0}: the board's flash has failed")]
    Flash(String),
}

/// A line that bytes come and go by.
trait Port: Read + Write {}
impl<P: Read + Write> Port for P {}

/// One end of a line, with a board at the other.
pub struct Station {
    port: Box<dyn Port>,
    decoder: Decoder<FromBoard>,
    heard: VecDeque<FromBoard>,
}

impl Station {
    /// Opens a line, and asks the board which version of the records it speaks.
    ///
    /// - `port`: a serial port's name, or `tcp:HOST:PORT`.
    /// - `baud`: bits a second of the serial port; USB has no use for it.
    ///
    /// # Errors
    /// If there is no such port, nobody answers, or in another version.
    pub fn open(port: &str, baud: u32) -> Result<Self, StationError> {
        let opened = match port.strip_prefix("tcp:") {
            Some(address) => tcp(address).map_err(|error| error.to_string()),
            None => serial(port, baud).map_err(|error| error.to_string()),
        };
        let refused = |why| StationError::Port { port: port.to_owned(), why, there: ports() };
        let mut station = Self { port: opened.map_err(refused)?, decoder: Decoder::new(), heard: VecDeque::new() };
        // Ends whatever stood on the line before.
        station.port.write_all(&[0])?;
        match station.hello()? {
            VERSION => Ok(station),
            other => Err(StationError::Version(other)),
        }
    }

    /// Says something.
    ///
    /// # Errors
    /// If the line breaks.
    pub fn say(&mut self, record: &ToBoard) -> Result<(), StationError> {
        let mut place = [0; FRAME_BYTES_MAX];
        let frame = encode(record, &mut place).map_err(io::Error::other)?;
        Ok(self.port.write_all(frame)?)
    }

    /// The next record, if one has come or comes soon.
    ///
    /// # Errors
    /// If the line breaks.
    pub fn listen(&mut self) -> Result<Option<FromBoard>, StationError> {
        if self.heard.is_empty() {
            let mut bytes = [0; 256];
            let count = match self.port.read(&mut bytes) {
                Ok(0) => return Err(StationError::Broken(ErrorKind::UnexpectedEof.into())),
                Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => 0,
                other => other?,
            };
            self.heard.extend(bytes[..count].iter().filter_map(|&byte| self.decoder.push(byte)));
        }
        Ok(self.heard.pop_front())
    }

    /// Says something, and waits for the answer that `find` knows.
    fn ask<T>(
        &mut self,
        record: &ToBoard,
        patience: Duration,
        find: impl Fn(FromBoard) -> Option<T>,
    ) -> Result<T, StationError> {
        let asked = Instant::now();
        self.say(record)?;
        while asked.elapsed() < patience {
            if let Some(answer) = self.listen()?.and_then(&find) {
                return Ok(answer);
            }
        }
        Err(StationError::Silent)
    }

    /// Version of the records that the board speaks.
    fn hello(&mut self) -> Result<u8, StationError> {
        self.ask(&ToBoard::Hello, PATIENCE, |record| match record {
            FromBoard::Hello(version) => Some(version),
            _ => None,
        })
    }

    /// The value of a parameter, as it flies from the next start on.
    ///
    /// # Errors
    /// If the board has none of this name, or does not answer.
    pub fn get(&mut self, name: &str) -> Result<f32, StationError> {
        let wanted = padded(name).ok_or_else(|| StationError::Unknown(name.to_owned()))?;
        let (value, outcome) = self.ask(&ToBoard::GetParameter(wanted), PATIENCE, about(wanted))?;
        outcome_of(outcome, name).map(|()| value)
    }

    /// Sets a parameter for good; returns whether the board has started anew for it.
    ///
    /// # Errors
    /// If the board refuses, with the reason, or does not answer.
    pub fn set(&mut self, name: &str, value: f32) -> Result<bool, StationError> {
        let wanted = padded(name).ok_or_else(|| StationError::Unknown(name.to_owned()))?;
        let (_, outcome) = self.ask(&ToBoard::SetParameter(wanted, value), PATIENCE, about(wanted))?;
        outcome_of(outcome, name)?;
        if outcome != Outcome::Restarting {
            return Ok(false);
        }
        self.wait_for_restart()?;
        if self.get(name)? == value { Ok(true) } else { Err(StationError::Flash(name.to_owned())) }
    }

    /// Orders something.
    ///
    /// # Errors
    /// If the board refuses, with the reason, or does not answer.
    pub fn order(&mut self, order: Order) -> Result<(), StationError> {
        let verdict = self.ask(&ToBoard::Order(order), PATIENCE, |record| match record {
            FromBoard::Ordered(verdict) => Some(verdict),
            _ => None,
        })?;
        match verdict {
            Verdict::Done => Ok(()),
            Verdict::Armed => Err(StationError::Armed),
            Verdict::OutOfRange => Err(StationError::BadOrder),
            Verdict::Unheard => Err(StationError::Unheard),
        }
    }

    /// Gives signs of life until the test on the bench is over, and shows every record on the way.
    ///
    /// # Errors
    /// If the board falls silent.
    pub fn accompany(&mut self, mut show: impl FnMut(&FromBoard)) -> Result<(), StationError> {
        let (mut lived, mut heard) = (Instant::now(), Instant::now());
        // What was said before the test began says that none runs.
        let mut seen = false;
        while heard.elapsed() < LOST {
            if lived.elapsed() >= LIFE {
                lived = Instant::now();
                self.say(&ToBoard::Hello)?;
            }
            let Some(record) = self.listen()? else { continue };
            heard = Instant::now();
            show(&record);
            if let FromBoard::Status(status) = record {
                if seen && !status.bench {
                    return Ok(());
                }
                seen |= status.bench;
            }
        }
        Err(StationError::Lost)
    }

    /// Waits until the board answers again.
    ///
    /// # Errors
    /// If it does not.
    pub fn wait_for_restart(&mut self) -> Result<(), StationError> {
        let since = Instant::now();
        loop {
            match self.hello() {
                Err(StationError::Silent) if since.elapsed() < RESTART_PATIENCE => {}
                other => return other.map(|_| ()),
            }
        }
    }
}

fn tcp(address: &str) -> io::Result<Box<dyn Port>> {
    let stream = TcpStream::connect(address)?;
    stream.set_nodelay(true)?;
    stream.set_read_timeout(Some(LOOK))?;
    Ok(Box::new(stream))
}

fn serial(port: &str, baud: u32) -> Result<Box<dyn Port>, serialport::Error> {
    Ok(Box::new(serialport::new(port, baud).timeout(LOOK).open()?))
}

/// The serial ports of this computer, for people.
fn ports() -> String {
    let names: Vec<_> =
        serialport::available_ports().unwrap_or_default().into_iter().map(|port| port.port_name).collect();
    if names.is_empty() { "there is no serial port".to_owned() } else { format!("there are {}", names.join(", ")) }
}

/// A name as records have it, if it is not too long.
fn padded(name: &str) -> Option<ParameterName> {
    let bytes = name.as_bytes();
    let mut padded = ParameterName::default();
    padded.get_mut(..bytes.len())?.copy_from_slice(bytes);
    Some(padded)
}

/// Finds the answer about a parameter.
fn about(wanted: ParameterName) -> impl Fn(FromBoard) -> Option<(f32, Outcome)> {
    move |record| match record {
        FromBoard::Parameter(name, value, outcome) if name == wanted => Some((value, outcome)),
        _ => None,
    }
}

fn outcome_of(outcome: Outcome, name: &str) -> Result<(), StationError> {
    match outcome {
        Outcome::Said | Outcome::Stored | Outcome::Restarting => Ok(()),
        Outcome::Unknown => Err(StationError::Unknown(name.to_owned())),
        Outcome::OutOfRange => Err(StationError::OutOfRange(name.to_owned())),
        Outcome::Armed => Err(StationError::Armed),
        Outcome::Failed => Err(StationError::Flash(name.to_owned())),
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use flight_link::{Status, Wiring};
    use serialport::{SerialPort, TTYPort};
    use std::cell::Cell;
    use std::thread;

    /// A serial line whose other end answers as `board` does; returns its name.
    pub(super) fn line(board: impl Fn(ToBoard) -> Vec<FromBoard> + Send + 'static) -> (String, TTYPort) {
        let (mut near, far) = TTYPort::pair().expect("a pair of ports");
        let name = far.name().expect("it has a name");
        near.set_timeout(Duration::from_millis(10)).expect("a timeout");
        thread::spawn(move || {
            let mut decoder = Decoder::new();
            let mut byte = [0];
            // Until the test has ended.
            loop {
                let Ok(1) = near.read(&mut byte) else { continue };
                for record in decoder.push(byte[0]).into_iter().flat_map(&board) {
                    let mut place = [0; FRAME_BYTES_MAX];
                    if near.write_all(encode(&record, &mut place).expect("it fits")).is_err() {
                        return;
                    }
                }
            }
        });
        (name, far)
    }

    /// As the image answers, with one parameter, a flash that holds up to 9, and its control loop stopped.
    fn board(record: ToBoard) -> Vec<FromBoard> {
        let about = |name: ParameterName, value, outcome| vec![FromBoard::Parameter(name, value, outcome)];
        match record {
            ToBoard::Hello => vec![FromBoard::Hello(VERSION)],
            ToBoard::GetParameter(name) if padded("ONE") == Some(name) => about(name, 1.5, Outcome::Said),
            ToBoard::SetParameter(name, value) if value <= 9.0 => about(name, value, Outcome::Stored),
            ToBoard::SetParameter(name, _) => about(name, 1.5, Outcome::OutOfRange),
            ToBoard::GetParameter(name) => about(name, f32::NAN, Outcome::Unknown),
            ToBoard::Order(_) => vec![FromBoard::Ordered(Verdict::Unheard)],
            ToBoard::VisionPose(_) | ToBoard::Log(_) => vec![],
        }
    }

    #[test]
    fn a_board_on_a_serial_port_is_asked_and_told() {
        let (name, _far) = line(board);
        let mut station = Station::open(&name, 115_200).expect("it answers");
        assert_eq!(station.get("ONE").unwrap(), 1.5);
        assert!(!station.set("ONE", 2.0).unwrap(), "no restart");
        let refused = |result: Result<bool, StationError>| result.unwrap_err().to_string();
        assert_eq!(refused(station.set("ONE", 10.0)), "ONE: the board refuses this value: it is not in its range");
        for name in ["TWO", "A_NAME_OF_MORE_THAN_16"] {
            let error = station.get(name).unwrap_err().to_string();
            assert_eq!(error, format!("{name}: the board has no parameter of this name"));
        }
        let error = station.order(Order::Stop).unwrap_err().to_string();
        assert_eq!(error, "refused: the board's control loop does not run; its log says why");
    }

    #[test]
    fn no_port_no_answer_and_another_version_are_told_apart() {
        let why = |port: &str| Station::open(port, 115_200).err().expect("refused").to_string();
        let nowhere = why("/dev/no_such_port");
        assert!(nowhere.starts_with("--port = /dev/no_such_port: cannot be opened: "), "{nowhere}");
        let (silent, _far) = line(|_| vec![]);
        assert!(why(&silent).starts_with("no answer within 1 s: is the board switched on"), "{}", why(&silent));
        let (newer, _far) = line(|_| vec![FromBoard::Hello(VERSION + 1)]);
        assert!(why(&newer).starts_with(&format!("the board speaks version {} of the records", VERSION + 1)));
    }

    #[test]
    fn a_test_on_the_bench_is_kept_alive_until_the_board_says_that_it_is_over() {
        // Signs of life: the first opens the line, five come while the test runs.
        let lives = Cell::new(0);
        let (name, _far) = line(move |record| {
            let ToBoard::Hello = record else { return vec![FromBoard::Ordered(Verdict::Done)] };
            lives.set(lives.get() + 1);
            let status = Status { bench: (2..7).contains(&lives.get()), steps: lives.get(), ..STATUS };
            vec![FromBoard::Hello(VERSION), FromBoard::Status(status)]
        });
        let mut station = Station::open(&name, 115_200).expect("it answers");
        station.order(Order::WiringCheck).expect("it begins");
        let mut last = 0;
        station
            .accompany(|record| {
                if let FromBoard::Status(status) = record {
                    last = status.steps;
                }
            })
            .expect("it ends");
        assert_eq!(last, 7);
    }

    const STATUS: Status = Status {
        time_us: 0,
        armed: false,
        landed: true,
        aim: 0,
        mode: 0,
        failsafes: 0,
        failing: 0,
        wiring: Wiring::Unknown,
        bench: false,
        battery_v: 16.0,
        battery_a: 2.5,
        used_as: 3_600.0,
        steps: 0,
        late: 0,
        load: 0.3,
        step_us_max: 300,
        dropped: 0,
    };
}
