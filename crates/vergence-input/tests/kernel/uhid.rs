//! /dev/uhid by hand: a HID device whose reports come from here.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::sync::{Arc, Mutex, mpsc};

/// A HID device on bus USB. Feature reports are answered, output reports are passed on.
pub(crate) struct Uhid {
    file: Arc<File>,
    pub(crate) outputs: mpsc::Receiver<Vec<u8>>,
    pub(crate) is_open: Arc<Mutex<bool>>,
}

pub(crate) struct Identity {
    pub(crate) name: &'static str,
    pub(crate) vendor: u16,
    pub(crate) product: u16,
    pub(crate) version: u16,
    pub(crate) serial: &'static str,
}

impl Uhid {
    pub(crate) fn new(identity: &Identity, descriptor: &[u8], features: BTreeMap<u8, Vec<u8>>) -> Self {
        let file = Arc::new(OpenOptions::new().read(true).write(true).open("/dev/uhid").expect("uhid"));
        let mut create = vec![0; 4376];
        create[..4].copy_from_slice(&11u32.to_le_bytes());
        create[4..4 + identity.name.len()].copy_from_slice(identity.name.as_bytes());
        create[196..196 + identity.serial.len()].copy_from_slice(identity.serial.as_bytes());
        create[260..262].copy_from_slice(&(descriptor.len() as u16).to_le_bytes());
        create[262..264].copy_from_slice(&3u16.to_le_bytes());
        create[264..268].copy_from_slice(&u32::from(identity.vendor).to_le_bytes());
        create[268..272].copy_from_slice(&u32::from(identity.product).to_le_bytes());
        create[272..276].copy_from_slice(&u32::from(identity.version).to_le_bytes());
        create[280..280 + descriptor.len()].copy_from_slice(descriptor);
        (&*file).write_all(&create).expect("created");
        let (send, outputs) = mpsc::channel();
        let is_open = Arc::new(Mutex::new(false));
        let (events, open) = (file.clone(), is_open.clone());
        // Ends with the process: a read that waits cannot be called off.
        std::thread::spawn(move || {
            let mut event = vec![0; 4380];
            while (&*events).read(&mut event).is_ok() {
                match event[0] {
                    4 => *open.lock().expect("no panic") = true,
                    5 => *open.lock().expect("no panic") = false,
                    6 => {
                        let size = usize::from(u16::from_le_bytes([event[4100], event[4101]]));
                        if send.send(event[4..4 + size].to_vec()).is_err() {
                            return;
                        }
                    }
                    9 => {
                        let report = features.get(&event[8]);
                        let mut reply = vec![0; 4110];
                        reply[..4].copy_from_slice(&10u32.to_le_bytes());
                        reply[4..8].copy_from_slice(&event[4..8]);
                        reply[8..10].copy_from_slice(&if report.is_some() { 0u16 } else { 5 }.to_le_bytes());
                        let report = report.map_or(&[][..], Vec::as_slice);
                        reply[10..12].copy_from_slice(&(report.len() as u16).to_le_bytes());
                        reply[12..12 + report.len()].copy_from_slice(report);
                        let _ = (&*events).write_all(&reply);
                    }
                    13 => {
                        let mut reply = vec![0; 10];
                        reply[..4].copy_from_slice(&14u32.to_le_bytes());
                        reply[4..8].copy_from_slice(&event[4..8]);
                        let _ = (&*events).write_all(&reply);
                    }
                    _ => {}
                }
            }
        });
        Self { file, outputs, is_open }
    }

    pub(crate) fn send(&self, report: &[u8]) {
        let mut input = vec![0; 6 + report.len()];
        input[..4].copy_from_slice(&12u32.to_le_bytes());
        input[4..6].copy_from_slice(&(report.len() as u16).to_le_bytes());
        input[6..].copy_from_slice(report);
        (&*self.file).write_all(&input).expect("sent");
    }

    pub(crate) fn is_open(&self) -> bool {
        *self.is_open.lock().expect("no panic")
    }
}

impl Drop for Uhid {
    fn drop(&mut self) {
        let _ = (&*self.file).write_all(&1u32.to_le_bytes());
    }
}
