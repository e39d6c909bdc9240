//! Recordings that are whole, and recordings that are broken in one place: one sentence each, with its file.

#![allow(clippy::unwrap_used, reason = "a test that cannot make its recording fails")]

use std::fs;
use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use vergence_geom::{Camera, Distortion, Lens, Rigid};
use vergence_sense::Imu;
use vergence_slam::Inertial;
use vergence_slam::dataset::{Calibration, Dataset, Opening, Rig, Writer, rig};
use vergence_slam::trajectory::Trajectory;
use vergence_time::{Span, Timestamp};

const CAMERA: &str = "%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [0.0, -1.0, 0.0, 0.05,
         1.0, 0.0, 0.0, OFFSET,
         0.0, 0.0, 1.0, 0.0,
         0.0, 0.0, 0.0, 1.0]
rate_hz: 20
resolution: [64, 48]
camera_model: pinhole
intrinsics: [40.0, 41.0, 31.5, 23.5] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [-0.28, 0.07, 0.0002, 1.8e-05]
";

const IMU: &str = "%YAML:1.0
T_BS:
  data: [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
rate_hz: 200
gyroscope_noise_density: 1.7e-04
gyroscope_random_walk: 1.9e-05
accelerometer_noise_density: 2.0e-3
accelerometer_random_walk: 3.0e-3
";

/// Where the tests' first frame lies in time: nanoseconds since 1970 have more digits than a float.
const START: i64 = 1_403_715_281_262_142_976;

/// A small recording of two cameras, five frames, with an inertial unit and truth.
fn whole(folder: &Path) {
    let mut encoded = Vec::new();
    let picture = image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * 3 + y) as u8]));
    picture.write_to(&mut std::io::Cursor::new(&mut encoded), image::ImageFormat::Png).unwrap();
    for camera in 0..2 {
        let place = folder.join(format!("mav0/cam{camera}"));
        fs::create_dir_all(place.join("data")).unwrap();
        fs::write(place.join("sensor.yaml"), CAMERA.replace("OFFSET", ["-0.06", "0.05"][camera])).unwrap();
        let mut table = "#timestamp [ns],filename\r\n".to_owned();
        for frame in 0..5 {
            let nanos = START + frame * 50_000_000;
            table += &format!("{nanos},{nanos}.png\r\n");
            fs::write(place.join(format!("data/{nanos}.png")), &encoded).unwrap();
        }
        fs::write(place.join("data.csv"), table).unwrap();
    }
    let place = folder.join("mav0/imu0");
    fs::create_dir_all(&place).unwrap();
    fs::write(place.join("sensor.yaml"), IMU).unwrap();
    let mut table =
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y,w_RS_S_z,a_RS_S_x,a_RS_S_y,a_RS_S_z\n".to_owned();
    for sample in 0..60 {
        table += &format!("{},0,0,0.1,0,0,9.81\n", START + sample * 5_000_000);
    }
    fs::write(place.join("data.csv"), table).unwrap();
    let truth = format!(
        "{}.262142976 1 2 3 0 0 0 1\n{}.312142976 1 2 3 0 0 0 1\n",
        START / 1_000_000_000,
        START / 1_000_000_000
    );
    fs::write(folder.join("gt_tum.txt"), truth).unwrap();
}

fn first_picture() -> String {
    format!("mav0/cam0/data/{START}.png")
}

#[test]
fn a_whole_recording_is_read() {
    let folder = tempfile::tempdir().unwrap();
    whole(folder.path());
    for root in [folder.path().to_owned(), folder.path().join("mav0")] {
        let dataset = Dataset::open(&root).unwrap();
        assert_eq!((dataset.cameras.len(), dataset.frames.len(), &dataset.pictures[..]), (2, 5, &[5, 5][..]));
        assert_eq!(dataset.frames[0].at.as_nanos(), START);
        assert_eq!(dataset.inertial.as_ref().map(|unit| unit.samples.len()), Some(60));
        let baseline = dataset.cameras[0].body_from_camera.inverse() * dataset.cameras[1].body_from_camera;
        assert!((baseline.translation.vector - Vector3::new(0.11, 0.0, 0.0)).norm() < 1e-12, "{baseline}");
        let pictures = dataset.pictures(4).unwrap();
        assert_eq!((pictures.len(), pictures[1].pixels[64 + 2]), (2, 7));
        assert!(dataset.depth(0).unwrap().is_none());
        assert_eq!(dataset.period().map(|period| period.as_nanos()), Some(50_000_000));
    }
    assert_eq!(Dataset::open(folder.path()).unwrap().truth.map(|truth| truth.poses.len()), Some(2));
}

/// Breaks one file of a whole recording; what opening it says.
#[test]
fn what_is_written_is_read_again() {
    let distortions = [
        Distortion::Radtan { radial: [-0.28, 0.07, 1e-3], tangential: [2e-4, 1.8e-5] },
        Distortion::KannalaBrandt { k: [0.003, 7e-4, -2e-3, 2e-4] },
        Distortion::DoubleSphere { xi: -0.2, alpha: 0.55 },
    ];
    let camera = |(n, distortion): (usize, &Distortion)| Camera {
        lens: Lens::new([40.125, 41.0], [31.5, 23.25], *distortion).unwrap(),
        size_px: [64, 48 + 2 * n as u32],
        body_from_camera: Rigid::new(Vector3::new(0.1 * n as f64, 1e-7, -0.02), Vector3::new(0.3, -1.2, 0.1)),
    };
    let cameras: Vec<Camera> = distortions.iter().enumerate().map(camera).collect();
    let written = Rig { cameras, inertial: Some((Inertial::EUROC, 200.0)) };
    let folder = tempfile::tempdir().unwrap();
    let mut writer = Writer::create(folder.path(), &written, 20.0).unwrap();
    let time = |k: i64| Timestamp::from_nanos(START + 50_000_000 * k);
    let pixels =
        |k: i64, height: i64| -> Vec<u8> { (0..64 * height).map(|i| (i * 7 + k * 31) as u8).collect() };
    for k in 0..4 {
        for n in 0..3 {
            writer.picture(n, time(k), &pixels(k, 48 + 2 * n as i64)).unwrap();
        }
    }
    let wrong = writer.picture(0, time(9), &[0; 3]).unwrap_err().to_string();
    assert!(wrong.contains("3072 pixels"), "{wrong}");
    let value = Imu {
        gyr_rad_s: Vector3::new(0.1, -1e-9, 0.0),
        acc_m_s2: Vector3::new(1.0 / 3.0, 9.81, -0.0),
        mag_ut: None,
    };
    let readings: Vec<_> = (0..40).map(|k| (Timestamp::from_nanos(START + 5_000_000 * k), value)).collect();
    let pose = |k| Rigid::new(Vector3::new(k as f64, 0.5, 0.0), Vector3::new(0.0, 0.1 * k as f64, 0.0));
    let truth = Trajectory { poses: (0..4).map(|k| (time(k), pose(k))).collect() };
    writer.finish(&readings, &truth).unwrap();

    let found = Dataset::open(folder.path()).unwrap();
    assert_eq!((found.frames.len(), &found.pictures[..], found.frames[3].at), (4, &[4, 4, 4][..], time(3)));
    let pictures = found.pictures(2).unwrap();
    assert!((0..3).all(|n| pictures[n].pixels == pixels(2, 48 + 2 * n as i64)));
    let inertial = found.inertial.unwrap();
    assert_eq!((inertial.unit, inertial.rate_hz), (Inertial::EUROC, 200.0));
    assert_eq!(inertial.samples, readings);
    let again = rig(folder.path()).unwrap();
    assert_eq!(again.inertial, Some((Inertial::EUROC, 200.0)));
    for cameras in [&found.cameras, &again.cameras] {
        for (found, written) in cameras.iter().zip(&written.cameras) {
            assert_eq!((found.lens, found.size_px), (written.lens, written.size_px));
            let off = found.body_from_camera.inverse() * written.body_from_camera;
            assert!(off.translation.vector.norm() < 1e-12 && off.rotation.angle() < 1e-12, "{off}");
        }
    }
    for (found, written) in found.truth.unwrap().poses.iter().zip(&truth.poses) {
        assert_eq!(found.0, written.0);
        assert!((found.1.inverse() * written.1).translation.vector.norm() < 1e-12);
    }
    assert!(rig(&folder.path().join("nowhere")).is_err());
}

fn broken(break_it: impl FnOnce(&Path)) -> String {
    let folder = tempfile::tempdir().unwrap();
    whole(folder.path());
    break_it(folder.path());
    let error = Dataset::open(folder.path()).map(|_| ()).unwrap_err().to_string();
    assert_eq!(error.lines().count(), 1, "{error}");
    error.replace(&format!("{}/", folder.path().display()), "")
}

fn edit(file: &str, from: &str, to: &str) -> String {
    broken(|folder| {
        let path: PathBuf = folder.join(file);
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.contains(from), "{file} has no {from}");
        fs::write(&path, text.replace(from, to)).unwrap();
    })
}

#[test]
fn a_broken_recording_has_one_sentence() {
    let said = broken(|folder| fs::remove_file(folder.join(first_picture())).unwrap());
    assert!(said.starts_with(&first_picture()) && said.contains("No such file"), "{said}");
    let said = broken(|folder| fs::write(folder.join(first_picture()), []).unwrap());
    assert_eq!(said, format!("{}: expected a picture, found 0 bytes", first_picture()));
    let said = broken(|folder| fs::write(folder.join("mav0/cam1/data.csv"), []).unwrap());
    assert_eq!(said, "mav0/cam1/data.csv: expected a file with something in it, found 0 bytes");

    let (second, third) = (START + 50_000_000, START + 100_000_000);
    let swap = |folder: &Path| {
        let path = folder.join("mav0/cam1/data.csv");
        let text = fs::read_to_string(&path).unwrap();
        let text =
            text.replace(&format!("{second},"), "X,").replace(&format!("{third},"), &format!("{second},"));
        fs::write(&path, text.replace("X,", &format!("{third},"))).unwrap();
    };
    let said = broken(swap);
    assert_eq!(
        said,
        format!("mav0/cam1/data.csv:4:1: expected times that grow (after {third} ns), found {second} ns")
    );
    let said = edit("mav0/cam0/data.csv", &format!("{second},"), &format!("{START},"));
    assert_eq!(
        said,
        format!("mav0/cam0/data.csv:3:1: expected each time once, found {START} ns a second time")
    );
    let said = edit("mav0/cam0/data.csv", &format!("{second},"), "soon,");
    assert_eq!(said, "mav0/cam0/data.csv:3:1: expected whole nanoseconds, found soon");
    let said = edit("mav0/cam0/data.csv", &format!(",{second}.png"), ",../../../secret.png");
    assert_eq!(
        said,
        "mav0/cam0/data.csv:3:2: expected the name of a picture in data/, found ../../../secret.png"
    );
    let said = edit("mav0/imu0/data.csv", &format!("{},", START + 5_000_000), &format!("{START},"));
    assert!(said.starts_with("mav0/imu0/data.csv:3:1: expected a time after"), "{said}");
}

#[test]
fn readings_of_another_flight_or_in_other_units_are_refused() {
    let every = |from: &str, to: &str| edit("mav0/imu0/data.csv", from, to);
    let said = every(",0,0,0.1,0,0,9.81", ",0,0,0.1,0,0,1.0");
    assert_eq!(
        said,
        "mav0/imu0/data.csv: expected accelerations in m/s² (gravity is 9.8), found 1.000 in the middle"
    );
    let said = every(",0,0,0.1,", ",0,0,57.3,");
    assert_eq!(said, "mav0/imu0/data.csv: expected turns in rad/s, found 57.3 in the middle: degrees?");
    // An hour later.
    let (day, other) =
        (format!("\n{}", START / 10_000_000_000), format!("\n{}", START / 10_000_000_000 + 360));
    let said = every(&day, &other);
    assert!(
        said.contains("expected readings at the times of the pictures")
            && said.contains("found readings from"),
        "{said}"
    );
}

/// The second camera's times, moved by so much.
fn shift_second(folder: &Path, nanos: i64) {
    let path = folder.join("mav0/cam1/data.csv");
    let shifted: String = fs::read_to_string(&path)
        .unwrap()
        .lines()
        .map(|line| match line.split_once(',') {
            Some((at, name)) if !at.starts_with('#') => {
                format!("{},{name}\n", at.parse::<i64>().unwrap() + nanos)
            }
            _ => format!("{line}\n"),
        })
        .collect();
    fs::write(&path, shifted).unwrap();
}

#[test]
fn clocks_of_cameras_may_differ_by_microseconds_and_by_more_where_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    whole(folder.path());
    shift_second(folder.path(), 3000);
    let dataset = Dataset::open(folder.path()).unwrap();
    assert_eq!((dataset.frames.len(), &dataset.pictures[..]), (5, &[5, 5][..]));
    assert!(dataset.frames.iter().enumerate().all(|(k, f)| f.at.as_nanos() == START + 50_000_000 * k as i64));
    assert_eq!(dataset.doubts(true), [""; 0]);

    shift_second(folder.path(), -2_503_000);
    let said = Dataset::open(folder.path()).map(|_| ()).unwrap_err().to_string();
    assert!(
        said.ends_with(
            "expected cameras with pictures at the same times (within 1.000 ms), found 5 pictures, 5 pictures and none in common; the nearest of \
             another camera is 2.500 ms earlier in the middle, and a longer pair_within_ms takes them together"
        ),
        "{said}"
    );
    let opening = |millis| Opening { pair_within: Span::from_millis(millis), ..Opening::default() };
    let found = Dataset::open_as(folder.path(), &opening(3)).unwrap();
    assert_eq!((found.frames.len(), found.apart, found.pair_within), (5, None, Span::from_millis(3)));
    let said = Dataset::open_as(folder.path(), &opening(101)).map(|_| ()).unwrap_err().to_string();
    assert_eq!(said, "pair_within_ms: expected 0 to 100, found 101");
}

#[test]
fn what_is_left_out_and_missing_is_said() {
    // Two pictures of the second camera and half a second of readings are missing.
    let folder = tempfile::tempdir().unwrap();
    whole(folder.path());
    let keep = |file: &str, is: &dyn Fn(usize) -> bool| {
        let path = folder.path().join(file);
        let text = fs::read_to_string(&path).unwrap();
        let kept: Vec<&str> = text.lines().enumerate().filter(|l| is(l.0)).map(|l| l.1).collect();
        fs::write(&path, kept.join("\n")).unwrap();
    };
    keep("mav0/cam1/data.csv", &|line| line != 2 && line != 4);
    keep("mav0/imu0/data.csv", &|line| !(11..19).contains(&line));
    let dataset = Dataset::open(folder.path()).unwrap();
    assert_eq!((dataset.frames.len(), &dataset.pictures[..]), (3, &[5, 3][..]));
    let said = dataset.doubts(true);
    assert_eq!(
        said,
        [
            "2 of 5 pictures of cam0 have no partner within 1.000 ms in every other camera: left out; the nearest is 50.000 ms away in the middle",
            "no readings for 0.045 s after 0.045 s (more than five periods)",
        ]
    );
    assert_eq!(dataset.doubts(false).len(), 1);
    let bag = folder.path().join("flight.bag");
    fs::write(&bag, "#ROSBAG").unwrap();
    let said = Dataset::open(&bag).map(|_| ()).unwrap_err().to_string();
    assert!(
        said.contains("expected a folder")
            && said.ends_with("kalibr_bagextractor makes one of a bag, found a file"),
        "{said}"
    );
}

#[test]
fn a_calibration_that_cannot_be_is_named() {
    let sheet = "mav0/cam1/sensor.yaml";
    for (from, to, expected) in [
        (
            "[40.0, 41.0, 31.5, 23.5]",
            "[0.0, 41.0, 31.5, 23.5]",
            "expected focal lengths above 0 px and below 1e6 px, found 0 and 41",
        ),
        ("[40.0, 41.0, 31.5, 23.5]", "[40.0, 41.0, 31.5]", "expected intrinsics: 4 numbers, found 3"),
        (
            "[40.0, 41.0, 31.5, 23.5]",
            "[40.0, .nan, 31.5, 23.5]",
            "expected intrinsics: finite numbers, found .nan",
        ),
        (
            "[40.0, 41.0, 31.5, 23.5]",
            "[40.0, 41.0, 315.0, 23.5]",
            "expected intrinsics: a principal point in the picture, found [315.0, 23.5]",
        ),
        ("[64, 48]", "[64, 0]", "expected resolution: whole numbers of 16 to 16384, found [64.0, 0.0]"),
        (
            "[-0.28, 0.07, 0.0002, 1.8e-05]",
            "[-28.0, 0.07, 0.0002, 1.8e-05]",
            "expected distortion_coefficients: a lens that sees the picture, found one whose picture folds over in its middle",
        ),
        (
            "radial-tangential",
            "wobbly",
            "expected distortion_model: radial-tangential, equidistant or none, found wobbly",
        ),
        (
            "[0.0, -1.0, 0.0, 0.05,",
            "[0.5, -1.0, 0.0, 0.05,",
            "expected T_BS: a rotation (orthonormal columns), found columns that are off by 0.750",
        ),
        (
            "[0.0, -1.0, 0.0, 0.05,",
            "[0.0, 1.0, 0.0, 0.05,",
            "expected T_BS: a rotation (determinant 1), found a mirror (determinant -1)",
        ),
        (
            "0.0, 0.0, 0.0, 1.0]",
            "0.0, 0.0, 0.0, 2.0]",
            "expected T_BS: the last row 0, 0, 0, 1, found [0.0, 0.0, 0.0, 2.0]",
        ),
        (
            "[0.0, -1.0, 0.0, 0.05,",
            "[0.0, -1.0, 0.0, 50.0,",
            "expected T_BS: a sensor within 5 m of its body, found 50.0 m: millimetres or centimetres?",
        ),
        ("T_BS:", "T_SB:", "expected T_BS: 16 numbers, found nothing"),
    ] {
        assert_eq!(edit(sheet, from, to), format!("{sheet}: {expected}"), "{from} -> {to}");
    }
    assert!(edit(sheet, "T_BS:", "T_BS: [").starts_with(&format!("{sheet}:")));
    let said = edit("mav0/imu0/sensor.yaml", "1.7e-04", "-1.0");
    assert_eq!(said, "mav0/imu0/sensor.yaml: expected gyroscope_noise_density: a number above 0, found -1.0");
}

const CHAIN: &str = "cam0:
  T_cam_imu:
  - [0.0, 1.0, 0.0, 0.06]
  - [-1.0, 0.0, 0.0, 0.05]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  distortion_model: radtan
  intrinsics: [40.0, 41.0, 31.5, 23.5]
  resolution: [64, 48]
  rostopic: /cam0/image_raw
  timeshift_cam_imu: 0.00125
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.11]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  distortion_model: radtan
  intrinsics: [40.0, 41.0, 31.5, 23.5]
  resolution: [64, 48]
";

/// Kalibr's files describe the rig that the folder's own do.
#[test]
fn kalibrs_files_take_the_place_of_the_folders_own() {
    let folder = tempfile::tempdir().unwrap();
    whole(folder.path());
    let own = Dataset::open(folder.path()).unwrap();
    let (chain, unit) = (folder.path().join("camchain-imucam.yaml"), folder.path().join("imu.yaml"));
    fs::write(&chain, CHAIN).unwrap();
    fs::write(&unit, IMU.replace("rate_hz", "rostopic: /imu0\nupdate_rate")).unwrap();
    for sensor in ["cam0", "cam1", "imu0"] {
        fs::remove_file(folder.path().join(format!("mav0/{sensor}/sensor.yaml"))).unwrap();
    }
    let calibration = Calibration::kalibr(&[unit.clone(), chain.clone()]).unwrap();
    let found =
        Dataset::open_as(folder.path(), &Opening { calibration: Some(&calibration), ..Opening::default() })
            .unwrap();
    assert_eq!(found.frames[0].at, Timestamp::from_nanos(START + 1_250_000));
    assert_eq!(
        found.inertial.as_ref().map(|i| (i.unit, i.rate_hz)),
        own.inertial.map(|i| (i.unit, i.rate_hz))
    );
    for (found, own) in found.cameras.iter().zip(&own.cameras) {
        assert_eq!((found.lens, found.size_px), (own.lens, own.size_px));
        let off = found.body_from_camera.inverse() * own.body_from_camera;
        assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-9, "{off}");
    }
    assert_eq!(found.cameras.len(), 2);

    let read = |text: &str| {
        fs::write(&chain, text).unwrap();
        let error = Calibration::kalibr(std::slice::from_ref(&chain)).map(|_| ()).unwrap_err().to_string();
        error.replace(&format!("{}: expected ", chain.display()), "")
    };
    assert_eq!(
        read(&CHAIN.replace("cam0:", "left:")),
        "gyroscope_noise_density: a number above 0, found nothing"
    );
    assert_eq!(read(&CHAIN.replace(" 0.06]", "]")), "cam0.T_cam_imu: 4 numbers, found 3");
    assert_eq!(
        read(&CHAIN.replace("0.00125", "1250000")),
        "cam0.timeshift_cam_imu: at most 10 s, found 1250000 s"
    );
    let model = "camera_model: pinhole or double-sphere (calibrate anew with pinhole-equi or ds), found omni";
    assert_eq!(read(&CHAIN.replace("pinhole", "omni")), format!("cam0.{model}"));
    assert_eq!(
        Calibration::kalibr(std::slice::from_ref(&unit)).map(|_| ()).unwrap_err().to_string(),
        format!("{}: expected a chain of cameras (cam0, cam1, …) of Kalibr, found none", unit.display())
    );
}

#[test]
fn pictures_that_are_none_are_named_when_they_are_wanted() {
    let folder = tempfile::tempdir().unwrap();
    whole(folder.path());
    fs::write(folder.path().join(first_picture()), b"no picture").unwrap();
    let said = Dataset::open(folder.path()).unwrap().pictures(0).unwrap_err().to_string();
    assert!(said.contains(".png: expected a PNG or JPEG picture, found"), "{said}");
    let mut bytes = Vec::new();
    let jpeg = image::ImageFormat::Jpeg;
    let noise = image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * 37 + y * 101) as u8]));
    noise.write_to(&mut std::io::Cursor::new(&mut bytes), jpeg).unwrap();
    let read = |bytes: &[u8]| {
        fs::write(folder.path().join(first_picture()), bytes).unwrap();
        Dataset::open(folder.path()).unwrap().pictures(0).map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(read(&bytes), Ok(()));
    let said = read(&bytes[..bytes.len() / 2]).unwrap_err();
    assert!(said.ends_with(".png: expected a whole JPEG picture, found one that is cut off"), "{said}");
    bytes.extend([0; 9]);
    assert_eq!(read(&bytes), Ok(()));
    image::GrayImage::new(32, 48).save(folder.path().join(first_picture())).unwrap();
    let said = Dataset::open(folder.path()).unwrap().pictures(0).unwrap_err().to_string();
    assert!(said.ends_with("expected 64x48 pixels, as the calibration says, found 32x48 pixels"), "{said}");
}

#[test]
fn folders_that_are_no_recording_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let said = Dataset::open(folder.path()).map(|_| ()).unwrap_err().to_string();
    assert!(said.contains("expected a folder with mav0/cam0"), "{said}");
    assert!(Dataset::open(&folder.path().join("nowhere")).is_err());
    // 7-Scenes with a hole.
    let pose = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n";
    for frame in [0, 2] {
        image::GrayImage::new(640, 480)
            .save(folder.path().join(format!("frame-{frame:06}.color.jpg")))
            .unwrap();
        fs::write(folder.path().join(format!("frame-{frame:06}.pose.txt")), pose).unwrap();
    }
    let said = Dataset::open(folder.path()).map(|_| ()).unwrap_err().to_string();
    assert!(said.contains("frame-000001.color.jpg: No such file"), "{said}");
}

#[test]
fn published_recordings_are_read() {
    let Some(data) =
        std::env::var_os("VERGENCE_DATA").map(PathBuf::from).filter(|path| path.join("slam").is_dir())
    else {
        let required =
            std::env::var("VERGENCE_REQUIRE").unwrap_or_default().split(',').any(|entry| entry == "data");
        assert!(!required, "VERGENCE_REQUIRE names data, but there is none");
        println!("skipped: no data (VERGENCE_DATA)");
        return;
    };
    let flight = Dataset::open(&data.join("slam/half_real_v101_14s")).unwrap();
    assert_eq!((flight.cameras.len(), flight.frames.len()), (2, 280));
    assert_eq!(flight.truth.as_ref().map(|truth| truth.poses.len()), Some(280));
    assert_eq!(flight.pictures(279).unwrap()[1].width, 752);
    let start = Dataset::open(&data.join("slam/euroc_v101_start")).unwrap();
    assert_eq!(
        (start.frames.len(), start.inertial.as_ref().map(|unit| unit.samples.len())),
        (30, Some(29_120))
    );
    let hand = Dataset::open(&data.join("slam/sevenscenes_rgbd")).unwrap();
    assert_eq!(
        (hand.frames.len(), hand.frames.iter().filter(|frame| frame.depth.is_some()).count()),
        (200, 20)
    );
    let depth = hand.depth(10).unwrap().unwrap();
    assert!(depth.metres.iter().filter(|d| **d > 0.3 && **d < 6.0).count() > 200_000);
}
