//! The sensors on the I2C bus: a barometer, which boards carry, and a magnetometer, which a builder may add.
//!
//! Each is looked for every second until it answers, and again when it no longer does; the other goes on meanwhile. A
//! transfer that does not end in time is given up, and the bus with it: it is opened anew. So a part that is absent, falls
//! silent or holds the bus costs its own values and nobody's time.
use core::cell::Cell;
use core::convert::Infallible;
use core::sync::atomic::{AtomicBool, Ordering};

use control_core::frames::{Body, Vec3};
use control_core::measurement::Stamped;
use embassy_futures::select::select;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::mutex::Mutex;
use embassy_time::{Duration, TimeoutError, Timer, with_timeout};
use embedded_hal_async::i2c::{self, I2c};
use firmware::atmosphere::altitude_m;
use firmware::dps310::{self, Calibration};
use firmware::qmc5883l::{self, field_ut};

use crate::board::{MAG_MOUNT, SensorBus, SensorPins};
use crate::tasks::{Newest, now_us};

/// Altitude in the standard atmosphere, above the first, m.
pub(crate) static BARO_ALTITUDE_M: Newest<f32> = Newest::new();
/// Magnetic field, µT.
pub(crate) static MAGNETIC_UT: Newest<Vec3<Body>> = Newest::new();
/// Whether the barometer has ever answered.
pub(crate) static BAROMETER_FOUND: AtomicBool = AtomicBool::new(false);

/// A transfer of 20 bytes takes half a millisecond, and control may take the core for half of that.
const TRANSFER: Duration = Duration::from_millis(5);
/// Time after which a part that does not answer is looked for again.
const RETRY: Duration = Duration::from_secs(1);
/// How long before the next sample is due its part is asked for it, how often from then on, and how many times in vain.
const EARLY: Duration = Duration::from_millis(2);
const ASK: Duration = Duration::from_micros(500);
const ASKED_MAX: u32 = 200;

/// Why a part is not served any more.
enum Trouble {
    /// It does not answer, or not as this part would.
    Part,
    /// A transfer has not ended, or has gone wrong otherwise.
    Bus,
}

type Shared<'a> = Mutex<NoopRawMutex, SensorBus<'a>>;

/// Serves both, for ever.
#[embassy_executor::task]
pub(crate) async fn sense(mut pins: SensorPins) -> ! {
    let origin_m = Cell::new(None);
    loop {
        let bus = Shared::new(pins.open());
        select(serve(|| barometer(&bus, &origin_m)), serve(|| magnetometer(&bus))).await;
        defmt::warn!("the sensor bus hangs and is opened anew");
        Timer::after(RETRY).await;
    }
}

/// Serves a part until the bus fails.
async fn serve<F: Future<Output = Result<Infallible, Trouble>>>(part: impl Fn() -> F) {
    while let Err(Trouble::Part) = part().await {
        Timer::after(RETRY).await;
    }
}

async fn barometer(bus: &Shared<'_>, origin_m: &Cell<Option<f32>>) -> Result<Infallible, Trouble> {
    let address = find_barometer(bus).await?;
    BAROMETER_FOUND.store(true, Ordering::Relaxed);
    write(bus, address, dps310::RESET).await?;
    Timer::after_micros(dps310::RESET_US).await;
    wait(bus, address, dps310::STATUS, dps310::CALIBRATION_READY).await?;
    let calibration = Calibration::new(&read(bus, address, dps310::CALIBRATION.0).await?);
    let [thermometer] = read(bus, address, dps310::THERMOMETER).await?;
    for register in dps310::setup(thermometer) {
        write(bus, address, register).await?;
    }
    loop {
        wait(bus, address, dps310::STATUS, dps310::PRESSURE_READY).await?;
        let time_us = now_us().saturating_sub(dps310::AVERAGED_US / 2);
        let burst = read(bus, address, dps310::BURST.0).await?;
        if let Some(altitude_m) = calibration.pressure_pa(&burst).and_then(altitude_m) {
            let first_m = origin_m.get().unwrap_or(altitude_m);
            origin_m.set(Some(first_m));
            BARO_ALTITUDE_M.signal(Stamped { time_us, value: altitude_m - first_m });
        }
        rest(dps310::SAMPLE_HZ).await;
    }
}

/// Where the barometer answers.
async fn find_barometer(bus: &Shared<'_>) -> Result<u8, Trouble> {
    for address in dps310::ADDRESSES {
        match read(bus, address, dps310::PRODUCT_ID.0).await {
            Ok([id]) if id == dps310::PRODUCT_ID.1 => return Ok(address),
            Err(Trouble::Bus) => return Err(Trouble::Bus),
            _ => {}
        }
    }
    Err(Trouble::Part)
}

async fn magnetometer(bus: &Shared<'_>) -> Result<Infallible, Trouble> {
    let [id] = read(bus, qmc5883l::ADDRESS, qmc5883l::CHIP_ID.0).await?;
    if id != qmc5883l::CHIP_ID.1 {
        return Err(Trouble::Part);
    }
    for register in qmc5883l::SETUP {
        write(bus, qmc5883l::ADDRESS, register).await?;
    }
    loop {
        wait(bus, qmc5883l::ADDRESS, qmc5883l::STATUS, qmc5883l::READY).await?;
        let time_us = now_us();
        let burst = read(bus, qmc5883l::ADDRESS, qmc5883l::BURST.0).await?;
        if let Some(value) = field_ut(&burst, &MAG_MOUNT) {
            MAGNETIC_UT.signal(Stamped { time_us, value });
        }
        rest(qmc5883l::SAMPLE_HZ).await;
    }
}

/// Waits until all of `bits` are set in a register.
async fn wait(bus: &Shared<'_>, address: u8, register: u8, bits: u8) -> Result<(), Trouble> {
    for _ in 0..ASKED_MAX {
        let [status] = read(bus, address, register).await?;
        if status & bits == bits {
            return Ok(());
        }
        Timer::after(ASK).await;
    }
    Err(Trouble::Part)
}

/// Waits until shortly before the next sample.
async fn rest(sample_hz: f32) {
    Timer::after(Duration::from_micros((1e6 / sample_hz) as u64) - EARLY).await;
}

async fn write(bus: &Shared<'_>, address: u8, (register, value): (u8, u8)) -> Result<(), Trouble> {
    exchange(bus, address, &[register, value], &mut []).await
}

/// Reads registers from `first` on.
async fn read<const N: usize>(bus: &Shared<'_>, address: u8, first: u8) -> Result<[u8; N], Trouble> {
    let mut bytes = [0; N];
    exchange(bus, address, &[first], &mut bytes).await?;
    Ok(bytes)
}

/// Writes, and then reads if there is anything to read into.
async fn exchange(bus: &Shared<'_>, address: u8, to: &[u8], from: &mut [u8]) -> Result<(), Trouble> {
    let mut bus = bus.lock().await;
    let _turn = crate::log_bus::TURN.lock().await;
    let transfer = async {
        if from.is_empty() {
            I2c::write(&mut *bus, address, to).await
        } else {
            I2c::write_read(&mut *bus, address, to, from).await
        }
    };
    judge(with_timeout(TRANSFER, transfer).await)
}

fn judge<E: i2c::Error>(result: Result<Result<(), E>, TimeoutError>) -> Result<(), Trouble> {
    match result {
        Ok(Ok(())) => Ok(()),
        Ok(Err(error)) if matches!(error.kind(), i2c::ErrorKind::NoAcknowledge(_)) => Err(Trouble::Part),
        Ok(Err(_)) | Err(TimeoutError) => Err(Trouble::Bus),
    }
}
