//! USB: a line to the station as a serial port of the computer, a CDC-ACM device on the full-speed port.
//!
//! Nothing is said until a program has opened the port, so that none finds what was said long before. Below control, as are
//! its interrupts: those of other drivers are above it.
//!
//! # Source
//! USB Class Definitions for Communications Devices 1.2, PSTN subclass. Vendor and product are the pair that Objective
//! Development shares for such devices, told apart by their texts
//! (<https://github.com/obdev/v-usb/blob/master/usbdrv/USB-IDs-for-free.txt>).
use embassy_futures::join::join4;
use embassy_usb::class::cdc_acm::{CdcAcmClass, State};
use embassy_usb::{Builder, Config};
use flight_link::Decoder;

use crate::board::{self, UsbPort};
use crate::line::{RECORDS, USB};

/// Vendor and product: a CDC-ACM device with texts of its own.
const IDS: (u16, u16) = (0x16c0, 0x27dd);
/// Longest packet of the full-speed bulk endpoints.
const PACKET: u16 = 64;
/// Bytes that are sent at once: less than a packet, for a full one would be waited on.
const CHUNK: usize = 63;

/// Speaks and listens for ever.
#[embassy_executor::task]
pub(crate) async fn serve(port: UsbPort) -> ! {
    let mut config = Config::new(IDS.0, IDS.1);
    config.manufacturer = Some("fault-tolerant quadrotor");
    config.product = Some(board::NAME);
    // A device, its interfaces and endpoints take 75 bytes, its capabilities 12.
    let (mut descriptor, mut capabilities, mut control) = ([0; 96], [0; 16], [0; 64]);
    let mut state = State::new();
    let mut builder = Builder::new(port, config, &mut descriptor, &mut capabilities, &mut [], &mut control);
    let class = CdcAcmClass::new(&mut builder, &mut state, PACKET);
    let mut device = builder.build();
    let (mut sender, mut receiver, changed) = class.split_with_control();
    let open = async {
        loop {
            changed.control_changed().await;
            USB.set_open(changed.dtr());
        }
    };
    let hear = async {
        let mut decoder = Decoder::new();
        let mut bytes = [0; PACKET as usize];
        loop {
            let Ok(count) = receiver.read_packet(&mut bytes).await else {
                USB.set_open(false);
                receiver.wait_connection().await;
                continue;
            };
            for record in bytes[..count].iter().filter_map(|&byte| decoder.push(byte)) {
                RECORDS.send((&USB, record)).await;
            }
        }
    };
    let speak = async {
        let mut bytes = [0; CHUNK];
        loop {
            let count = USB.next(&mut bytes).await;
            // A cable that is pulled is noticed by whoever listens.
            let _ = sender.write_packet(&bytes[..count]).await;
        }
    };
    join4(device.run(), open, hear, speak).await.0
}
