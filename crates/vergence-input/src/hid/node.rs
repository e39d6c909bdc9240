//! The HID devices that there are, and reading from one.

use std::collections::BTreeMap;
use std::ffi::CString;
use std::io::{Error, ErrorKind};
use std::path::Path;
use std::time::Duration;

use hidapi::{HidApi, HidDevice};

use super::descriptor::Layout;
use super::mapping::{Identity, Mapping};
use crate::claim::{Claim, is_claimed};
use crate::config::Config;
use crate::found::Found;

/// Where reports of a device come from.
pub trait Reports: Send {
    /// Reads one report, its number first where the device has several kinds, waiting at most `longest` for it; 0 where none
    /// came.
    ///
    /// # Errors
    /// Where the device is gone.
    fn read(&mut self, report: &mut [u8], longest: Duration) -> std::io::Result<usize>;

    /// Its report descriptor.
    ///
    /// # Errors
    /// Where the device is gone.
    fn descriptor(&self) -> std::io::Result<Vec<u8>>;
}

impl Reports for Opened {
    fn read(&mut self, report: &mut [u8], longest: Duration) -> std::io::Result<usize> {
        let millis = i32::try_from(longest.as_millis()).unwrap_or(i32::MAX);
        self.device.read_timeout(report, millis).map_err(|error| Error::new(ErrorKind::BrokenPipe, error))
    }

    fn descriptor(&self) -> std::io::Result<Vec<u8>> {
        let mut bytes = vec![0; 4096];
        let length = self.device.get_report_descriptor(&mut bytes).map_err(Error::other)?;
        bytes.truncate(length);
        Ok(bytes)
    }
}

/// Every HID device, as mappings see it.
fn all() -> Vec<(Found, Identity)> {
    let api = match HidApi::new() {
        Ok(api) => api,
        Err(error) => {
            log::debug!("HID devices cannot be listed: {error}");
            return Vec::new();
        }
    };
    // One entry for each usage of a node.
    let mut nodes: BTreeMap<String, (Found, Identity)> = BTreeMap::new();
    for info in api.device_list() {
        let path = info.path().to_string_lossy().into_owned();
        let (_, identity) = nodes.entry(path.clone()).or_insert_with(|| {
            let mut found = Found::new("hid", path);
            (found.vendor_id, found.product_id) = (Some(info.vendor_id()), Some(info.product_id()));
            found.serial_number = info.serial_number().filter(|text| !text.is_empty()).map(str::to_owned);
            let maker = info.manufacturer_string().unwrap_or_default();
            let product = info.product_string().unwrap_or_default();
            let name = format!("{maker} {product}");
            if !name.trim().is_empty() {
                name.trim().clone_into(&mut found.name);
            }
            let identity =
                Identity { vendor_id: info.vendor_id(), product_id: info.product_id(), usages: Vec::new() };
            (found, identity)
        });
        identity.usages.push((info.usage_page(), info.usage()));
    }
    nodes.into_values().collect()
}

/// The mappings: those of the configuration first.
pub(super) fn mappings(config: &Config) -> Vec<Mapping> {
    let mut mappings = config.hid_mappings.clone();
    mappings.extend(Mapping::shipped());
    mappings
}

/// What the reports of the node at `path` are, as the kernel tells everybody: also who may not open it.
fn told_layout(path: &str) -> Option<Layout> {
    let node = Path::new(path).file_name()?;
    let told = Path::new("/sys/class/hidraw").join(node).join("device/report_descriptor");
    Layout::parse(&std::fs::read(told).ok()?).ok()
}

/// The HID devices for which there is a mapping that finds something in their reports, where these are known.
pub fn found(config: &Config) -> Vec<Found> {
    let mut all = look_at(config);
    all.retain(|found| !found.streams.is_empty());
    all
}

/// The HID devices that no mapping finds anything of, keyboards, mice and pads left out: their problem says what is in their reports.
pub fn unmapped(config: &Config) -> Vec<Found> {
    let mut all = look_at(config);
    all.retain(|found| found.streams.is_empty());
    all
}

/// Pointers, mice, joysticks, pads, keyboards, keypads: what other adapters read.
fn is_of_others(identity: &Identity) -> bool {
    identity.usages.iter().any(|usage| matches!(usage, (0x01, 0x01 | 0x02 | 0x04..=0x07)))
}

fn look_at(config: &Config) -> Vec<Found> {
    let mappings = mappings(config);
    let each = all().into_iter().filter_map(|(mut found, identity)| {
        let layout = told_layout(&found.path);
        if let Some(mapping) = mappings.iter().find(|mapping| mapping.fits(&identity)) {
            found.streams = match &layout {
                Some(layout) => {
                    mapping.plan(layout).streams.into_iter().map(|resolved| resolved.stream.name).collect()
                }
                None => mapping.streams().map(str::to_owned).collect(),
            };
        }
        if found.streams.is_empty() {
            if is_of_others(&identity) {
                return None;
            }
            let fields = layout.iter().flat_map(|layout| &layout.reports).flat_map(|report| {
                let id = report.id.map_or_else(|| "-".to_owned(), |id| id.to_string());
                report.fields.iter().map(move |field| {
                    let ((page, usage), slot) = (field.usage, field.slot);
                    format!("{page:02x}:{usage:02x} (report {id}, bit {}, {} bits)", slot.bit, slot.bits)
                })
            });
            let fields: Vec<String> = fields.take(64).collect();
            let fields =
                if fields.is_empty() { "nothing that is known".to_owned() } else { fields.join(", ") };
            found.problem = Some(format!("no mapping is for it; its reports hold {fields}"));
            found.remedy = Some("a mapping file, named in --config (MAPPING.md)".to_owned());
        } else {
            found.check_access("input");
        }
        Some(found)
    });
    each.collect()
}

/// The mapping for a device, and the node that it has now, perhaps another than before.
pub(super) fn look_up(device: &Found, config: &Config) -> Option<(Found, Mapping)> {
    let mut nodes = all();
    nodes.retain(|(found, _)| !is_claimed(&found.path));
    let same_path = nodes.iter().find(|(found, _)| found.path == device.path && found.is_same_device(device));
    let (found, identity) =
        same_path.or_else(|| nodes.iter().find(|(found, _)| found.is_same_device(device)))?;
    let mapping = mappings(config).into_iter().find(|mapping| mapping.fits(identity))?;
    Some((found.clone(), mapping))
}

/// A device that counts as read.
pub(super) struct Opened {
    device: HidDevice,
    _claim: Claim,
}

pub(super) fn open(path: &str) -> std::io::Result<Opened> {
    let name = CString::new(path).map_err(Error::other)?;
    let api = HidApi::new().map_err(Error::other)?;
    let device = api.open_path(&name).map_err(Error::other)?;
    Ok(Opened { device, _claim: Claim::on(path) })
}
