//! Limits: files are rejected by their headers, with little memory and time, if they claim more than they contain, more
//! than is allowed, or more than fits into memory.
//!
//! The tests build these files. Each run has an address space of [`ADDRESSES`] (`ulimit -v`), most of which the
//! program's code, threads and stacks use: an attempt to allocate the claimed size would fail and end the process by a
//! signal.

use crate::support::card::Card;
use crate::support::{Folder, Run, jpeg, small, small_jpeg};
use exr::prelude::{Image, SpecificChannels, Vec2, WritableImage};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use hdralign::align::{AlignMode, AlignOptions};
use hdralign::batch::{job, plan::Job};
use hdralign::pipeline::{self, Options, Progress, Stage};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use std::fs::{self, File};
use std::io::Write;
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Address space in kB: less than a gigabyte, which every file claims at least.
const ADDRESSES: u32 = 900_000;

/// Limit of the CPU time in seconds; milliseconds are enough. The system ends a run that needs more; other work on the
/// machine does not count.
const SECONDS: u32 = 10;

/// Runs `line` in `folder` with `kilobytes` of address space and [`SECONDS`] of CPU time.
#[cfg(unix)]
fn within(folder: &Folder, kilobytes: u32, line: &str) -> Run {
    let script = format!("ulimit -t {SECONDS} && ulimit -v {kilobytes} && exec \"$0\" {line}");
    let program = env!("CARGO_BIN_EXE_hdralign");
    let mut child = Command::new("sh");
    let output = child.args(["-c", &script, program]).current_dir(folder.path()).stdin(Stdio::null());
    let output = output.output().expect("sh starts");
    let code = output.status.code();
    let stderr = String::from_utf8(output.stderr).expect("UTF-8 on stderr");
    Run {
        code: code.unwrap_or_else(|| panic!("{line}: ended by a signal: {:?}\n{stderr}", output.status)),
        stdout: String::from_utf8(output.stdout).expect("UTF-8 on stdout"),
        stderr,
    }
}

/// Checks that `line` is refused in little time and memory, with all of `said` in the message, and leaves no files.
#[cfg(unix)]
fn refused(folder: &Folder, line: &str, said: &[&str]) {
    let before = folder.listing();
    // Each thread needs address space for its stack, so there are only two; `compare` has no --threads.
    let threads = if line.starts_with("compare") { "" } else { "--threads 2" };
    let run = within(folder, ADDRESSES, &format!("{line} {threads}"));
    assert!(matches!(run.code, 1 | 2), "{line}\n{run:?}");
    assert_eq!((run.stdout.as_str(), folder.listing()), ("", before), "{line}");
    for part in said {
        assert!(run.stderr.contains(part), "{line}\n{}does not say {part:?}", run.stderr);
    }
}

/// Returns `count` zeros, compressed by deflate to about a thousandth.
fn zeros(count: usize) -> Vec<u8> {
    let mut packer = ZlibEncoder::new(Vec::new(), Compression::new(1));
    let some = vec![0; 1 << 20];
    for _ in 0..count >> 20 {
        packer.write_all(&some).expect("in memory");
    }
    packer.write_all(&some[..count & ((1 << 20) - 1)]).expect("in memory");
    packer.finish().expect("in memory")
}

fn chunk(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
    let mut crc = flate2::Crc::new();
    crc.update(kind);
    crc.update(content);
    [&(content.len() as u32).to_be_bytes()[..], kind, content, &crc.sum().to_be_bytes()].concat()
}

/// Returns a grey 8-bit PNG with this size in its header, with `data` as its pixel data and the chunks `others` before.
fn png(width: u32, height: u32, others: &[Vec<u8>], data: &[u8]) -> Vec<u8> {
    let size = [width.to_be_bytes(), height.to_be_bytes()].concat();
    let head = chunk(b"IHDR", &[&size[..], &[8, 0, 0, 0, 0]].concat());
    let signature = b"\x89PNG\r\n\x1a\n".to_vec();
    [signature, head, others.concat(), chunk(b"IDAT", data), chunk(b"IEND", &[])].concat()
}

/// Returns a TIFF with one strip, `data`, and with `tags`, each of which has one number.
fn tiff(tags: &[(u16, u32)], data: &[u8]) -> Vec<u8> {
    let mut all = tags.to_vec();
    let count = all.len() as u32 + 2;
    all.extend([(273, 8 + 2 + 12 * count + 4), (279, data.len() as u32)]);
    all.sort_unstable();
    let mut bytes = b"II\x2a\0\x08\0\0\0".to_vec();
    bytes.extend((all.len() as u16).to_le_bytes());
    for (tag, value) in all {
        bytes.extend(tag.to_le_bytes());
        bytes.extend([4, 0, 1, 0, 0, 0]);
        bytes.extend(value.to_le_bytes());
    }
    bytes.extend([0; 4]);
    bytes.extend(data);
    bytes
}

/// Returns a grey TIFF with samples of `bits` bits, which are floats if `format` is 3; `is_packed` if `data` are
/// compressed by deflate.
fn grey_tiff(size: (u32, u32), bits: u32, format: u32, is_packed: bool, data: &[u8]) -> Vec<u8> {
    let packing = if is_packed { 8 } else { 1 };
    let tags =
        [(256, size.0), (257, size.1), (258, bits), (259, packing), (262, 1), (277, 1), (278, size.1), (339, format)];
    tiff(&tags, data)
}

/// Returns the small frame 2 as a JPEG with another size in its header (SOF0: marker, length, depth, height, width).
fn jpeg_of(width: u16, height: u16) -> Vec<u8> {
    let mut bytes = small_jpeg(2).to_vec();
    let at = bytes.windows(2).position(|w| w == [0xFF, 0xC0]).expect("a baseline JPEG");
    bytes[at + 5..at + 7].copy_from_slice(&height.to_be_bytes());
    bytes[at + 7..at + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

#[cfg(unix)]
#[test]
fn photographs_with_impossible_sizes_are_rejected_by_their_headers() {
    let folder = Folder::with_bracket();
    let some = zeros(1 << 16);
    let bombs: [(&str, Vec<u8>, &[&str]); 10] = [
        ("a.png", png(60_000, 60_000, &[], &some), &["60000x60000", "500 million", "--max-pixels 3600M"]),
        ("a.png", png(u32::MAX / 2, u32::MAX / 2, &[], &some), &["more than the 500 million"]),
        ("a.png", png(20_000, 20_000, &[], &some), &["too short", "truncated"]),
        ("a.png", png(20_000, 20_000, &[], &zeros(400_020_000)), &["20000x20000", "MB", "--max-memory"]),
        ("a.jpg", jpeg_of(65_535, 65_535), &["65535x65535", "--max-pixels"]),
        ("a.jpg", jpeg_of(22_000, 22_000), &["too short"]),
        ("a.tif", grey_tiff((1 << 31, 1 << 31), 8, 1, false, &[0; 99]), &["more than the 500 million"]),
        ("a.tif", grey_tiff((20_000, 20_000), 8, 1, false, &[0; 99]), &["too short"]),
        ("a.tif", grey_tiff((20_000, 20_000), 16, 1, true, &zeros(800_000_000)), &["20000x20000", "--max-memory"]),
        ("a.tif", grey_tiff((0, 100), 8, 1, false, &[0; 99]), &["a.tif"]),
    ];
    for (name, bytes, said) in bombs {
        folder.put(name, &bytes);
        refused(&folder, &format!("merge w1.jpg {name} -o a.exr"), &[&[name], said].concat());
        fs::remove_file(folder.at(name)).expect("it was put there");
    }
}

/// Every command that reads photographs, with the same file.
#[cfg(unix)]
#[test]
fn every_command_rejects_impossible_sizes() {
    let folder = Folder::with_bracket();
    folder.put("a.png", &png(60_000, 60_000, &[], &zeros(1 << 16)));
    for line in [
        "merge a.png w1.jpg -o a.exr",
        "align w1.jpg a.png",
        "response w1.jpg a.png",
        "inspect w1.jpg a.png",
        "compare a.png w1.jpg",
        "compare w1.jpg a.png",
    ] {
        refused(&folder, line, &["a.png", "60000x60000", "--max-pixels 3600M"]);
    }
    let run = within(&folder, ADDRESSES, "batch . --dry-run --bracket 5 --threads 2");
    assert!(run.code == 0 && run.stdout.contains("./a.png") && run.stdout.contains("60000x60000"), "{run:?}");
}

/// Files contain compressed data in addition to the picture: a profile and a text.
#[cfg(unix)]
#[test]
fn compressed_metadata_are_limited() {
    let folder = Folder::empty();
    let bomb = zeros(1 << 30);
    for i in 2..=3 {
        let picture = small(i);
        let mut bytes = Vec::new();
        let encoder = PngEncoder::new(&mut bytes);
        encoder.write_image(&picture, picture.width(), picture.height(), ExtendedColorType::Rgb8).expect("a PNG");
        let profile = chunk(b"iCCP", &[b"profile\0\0", &bomb[..]].concat());
        let text = chunk(b"zTXt", &[b"Comment\0\0", &bomb[..]].concat());
        // The position after the IHDR chunk, whose content has 13 bytes.
        let at = 8 + 12 + 13;
        let file = [&bytes[..at], &profile, &text, &bytes[at..]].concat();
        folder.put(&format!("p{i}.png"), &file);
    }
    let run = within(&folder, ADDRESSES, "merge -e=-2,0 p2.png p3.png --align none -o a.png --threads 2").done();
    assert!(run.stderr.contains("p2.png: its colour profile is damaged"), "{}", run.stderr);
}

/// Returns the bytes of a small OpenEXR file.
fn exr(folder: &Folder) -> Vec<u8> {
    let channels = SpecificChannels::rgb(|at: Vec2<usize>| (at.x() as f32, 0.5f32, at.y() as f32));
    Image::from_channels((40, 30), channels).write().to_file(folder.at("small.exr")).expect("an EXR");
    let bytes = folder.bytes("small.exr");
    fs::remove_file(folder.at("small.exr")).expect("it was written");
    bytes
}

/// Returns the bytes of a small OpenEXR file whose data window is changed to end at the column `right` and the row
/// `bottom`.
fn exr_of(folder: &Folder, right: i32, bottom: i32) -> Vec<u8> {
    let mut bytes = exr(folder);
    for name in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = bytes.windows(name.len()).position(|w| w == name).expect("a window") + name.len() + 4;
        bytes[at + 8..at + 12].copy_from_slice(&right.to_le_bytes());
        bytes[at + 12..at + 16].copy_from_slice(&bottom.to_le_bytes());
    }
    bytes
}

#[cfg(unix)]
#[test]
fn radiance_maps_with_impossible_sizes_are_rejected_by_their_headers() {
    let folder = Folder::empty();
    let hdr = |size: &str, data: &[u8]| [format!("#?RADIANCE\n\n{size}\n").as_bytes(), data].concat();
    // A pixel, and 255, 255 << 8 and 255 << 16 repetitions of this pixel: 16.7 million pixels in 16 bytes.
    let row = [[9, 9, 9, 130], [1, 1, 1, 255], [1, 1, 1, 255], [1, 1, 1, 255]].concat();
    let bombs: [(&str, Vec<u8>, &[&str]); 11] = [
        ("a.exr", exr_of(&folder, i32::MAX - 1, i32::MAX - 1), &["a.exr"]),
        ("a.exr", exr_of(&folder, 99_999, 99_999), &["100000x100000", "--max-pixels 10000M"]),
        ("a.exr", exr_of(&folder, 19_999, 19_999), &["too short"]),
        ("a.hdr", hdr("-Y 100 +X 16711936", &row.repeat(100)), &["16711936x100", "--max-pixels 1672M"]),
        ("a.hdr", hdr("-Y 25 +X 16711936", &row.repeat(25)), &["16711936x25", "5014 MB", "memory"]),
        ("a.hdr", hdr("-Y 4000000000 +X 4000000000", &row), &["too short"]),
        ("a.hdr", hdr("-Y 18446744073709551615 +X 2", &row), &["too short"]),
        ("a.tif", grey_tiff((1 << 31, 1 << 31), 32, 3, false, &[0; 99]), &["more than the 500 million"]),
        ("a.tif", grey_tiff((20_000, 20_000), 32, 3, false, &[0; 99]), &["too short"]),
        ("a.tif", grey_tiff((10_000, 10_000), 32, 3, true, &zeros(400_000_000)), &["10000x10000", "2002 MB", "memory"]),
        (
            "a.tif",
            tiff(
                &[(256, 9), (257, 9), (258, 32), (259, 8), (262, 1), (277, 65535), (278, 9), (339, 3)],
                &zeros(1 << 20),
            ),
            &["65535 channels"],
        ),
    ];
    for (name, bytes, said) in bombs {
        folder.put(name, &bytes);
        refused(&folder, &format!("tonemap {name} -o a.png"), &[&[name], said].concat());
        if name != "a.tif" {
            refused(&folder, &format!("compare {name} {name}"), said);
        }
        fs::remove_file(folder.at(name)).expect("it was put there");
    }
}

#[test]
fn limits_are_set_by_the_user() {
    let folder = Folder::with_bracket();
    // The frames have 300 x 200 = 60 000 pixels.
    let merge = "merge w2.jpg w3.jpg --align none -q -o";
    let run = folder.line(&format!("{merge} a.exr --max-pixels 59999"));
    assert!(run.code == 1 && run.stderr.contains("the 59999 allowed"), "{run:?}");
    folder.line(&format!("{merge} a.exr --max-pixels 60k")).done();
    let run = folder.line("tonemap a.exr -o b.png --max-pixels 59999");
    assert!(run.code == 1 && run.stderr.contains("a.exr") && run.stderr.contains("--max-pixels"), "{run:?}");
    folder.line("tonemap a.exr -o b.png --max-pixels 0.06M").done();
    let run = folder.line("compare a.exr a.exr --max-pixels 59999");
    assert!(run.code == 2 && run.stderr.contains("--max-pixels"), "{run:?}");
    folder.line("compare a.exr a.exr --max-pixels 60000").done();
    for wrong in ["0", "many", "-3", "5K-"] {
        let run = folder.line(&format!("{merge} c.exr --max-pixels={wrong}"));
        assert!(run.code == 2 && run.stderr.contains("--max-pixels") && run.stderr.contains("500M"), "{run:?}");
    }
}

/// Returns a bracket as written by a camera, its paths, and the number of pixels of a frame. (A batch would take the
/// small frames of other tests for results of hdralign.)
fn card() -> (Folder, Vec<PathBuf>, u64) {
    let folder = Folder::empty();
    let paths = Card::new(96).bracket(&[-2.0, 0.0, 2.0]).write(folder.path()).remove(0);
    let (width, height) = image::image_dimensions(&paths[0]).expect("a photograph");
    (folder, paths, u64::from(width) * u64::from(height))
}

/// A plan contains the size of its photographs, so a job may read photographs of this size without `--max-pixels`.
#[test]
fn batch_respects_max_pixels_and_job_reads_its_planned_size() {
    let (folder, _, pixels) = card();
    let (less, planning) = (pixels - 1, "batch . -d out --formats png --align none");
    let run = folder.line(&format!("batch . --dry-run --max-pixels {less}"));
    assert!(run.code == 1 && run.stdout.contains(&format!("the {less} allowed")), "{run:?}");
    let plan = folder.line(&format!("{planning} --plan --max-pixels {pixels}")).done().stdout;
    folder.put("plan.jsonl", plan.as_bytes());
    let id = Job::read_all(&folder.at("plan.jsonl")).expect("a plan").remove(0).id;
    let run = folder.line(&format!("batch --run plan.jsonl --id {id} --max-pixels {less}"));
    assert!(run.code == 1 && run.stderr.contains(&format!("the {less} allowed")), "{run:?}");
    folder.line(&format!("batch --run plan.jsonl --id {id}")).done();
}

/// A single photograph, of 20 MP with 16 bits, needs more than the memory limit.
#[test]
fn photograph_over_the_memory_limit_is_named_with_its_size() {
    let folder = Folder::empty();
    for name in ["a.tif", "b.tif"] {
        folder.put(name, &grey_tiff((5000, 4000), 16, 1, true, &zeros(40_000_000)));
    }
    let run = folder.line("merge -e=0,1 a.tif b.tif -o a.exr --max-memory 64MB");
    assert!(run.code == 1 && run.stdout.is_empty(), "{run:?}");
    for part in ["a.tif: ", "5000x4000", "needs 161 MB", "the 38 MB", "--max-memory"] {
        assert!(run.stderr.contains(part), "{} does not say {part}", run.stderr);
    }
}

#[cfg(unix)]
#[test]
fn files_of_absurd_length_are_not_read() {
    let folder = Folder::with_bracket();
    let sparse = |name: &str, start: &[u8]| {
        folder.put(name, start);
        File::options()
            .write(true)
            .open(folder.at(name))
            .expect("it is there")
            .set_len(100_000_000_000)
            .expect("sparse");
    };
    sparse("huge.jpg", small_jpeg(2));
    sparse("huge.exr", b"\x76\x2f\x31\x01\x02\0\0\0");
    sparse("huge.tif", b"II\x2a\0\x08\0\0\0");
    sparse("huge.json", b"{");
    sparse("huge.csv", b"#");
    sparse("huge.rsp", b"1");
    for line in [
        "merge w1.jpg huge.jpg -o a.png",
        "compare w1.jpg huge.jpg",
        "compare huge.tif huge.exr",
        "tonemap huge.exr -o a.png",
        "merge w1.jpg w2.jpg --response huge.json -o a.png",
        "merge w1.jpg w2.jpg --response huge.csv -o a.png",
        "merge w1.jpg w2.jpg --response huge.rsp -o a.png",
        "merge w1.jpg w2.jpg --transforms huge.json -o a.png",
        "batch --run huge.json --id x",
        "batch --summarize huge.json",
    ] {
        refused(&folder, line, &["huge.", "100000 MB"]);
    }
}

#[cfg(target_os = "linux")]
#[test]
fn devices_and_folders_are_rejected() {
    let folder = Folder::with_bracket();
    fs::create_dir(folder.at("sub.jpg")).expect("a folder");
    let zero = ["/dev/zero", "MB are read"];
    refused(&folder, "merge w1.jpg /dev/zero -o a.png", &["/dev/zero", "begins with zeros"]);
    refused(&folder, "merge w1.jpg w2.jpg --transforms /dev/zero -o a.png", &zero);
    refused(&folder, "merge w1.jpg /dev/null -o a.png", &["/dev/null", "empty"]);
    refused(&folder, "tonemap /dev/zero -o a.png", &["/dev/zero", "a pipe or a device"]);
    refused(&folder, "compare /dev/zero w1.jpg", &["/dev/zero", "a pipe or a device"]);
    for line in ["merge w1.jpg sub.jpg -o a.png", "tonemap sub.jpg -o a.png", "compare w1.jpg sub.jpg"] {
        refused(&folder, line, &["sub.jpg", "it is a folder"]);
    }
}

/// A pipe that is named on the command line is read to its end; a pipe in a searched folder is not read.
#[cfg(unix)]
#[test]
fn pipe_is_read_if_named_and_ignored_in_a_folder() {
    let folder = Folder::with_bracket();
    assert!(Command::new("mkfifo").arg(folder.at("p.jpg")).status().expect("mkfifo").success());
    let run = folder.line("batch . --dry-run");
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(run.stdout.contains("p.jpg") && run.stdout.contains("a pipe or a device"), "{}", run.stdout);
    let (path, bytes) = (folder.at("p.jpg"), small_jpeg(2).to_vec());
    let writer = std::thread::spawn(move || fs::write(path, bytes));
    folder.line("merge p.jpg w3.jpg --align none -o piped.png").done();
    writer.join().expect("no panic").expect("written");
    folder.line("merge w2.jpg w3.jpg --align none -o plain.png").done();
    assert!(folder.bytes("piped.png") == folder.bytes("plain.png"));
}

#[test]
fn a_thousand_photographs_are_too_many_for_a_bracket() {
    let folder = Folder::empty();
    let names: Vec<String> = (0..1001).map(|i| format!("{i}.jpg")).collect();
    let run = folder.run(["merge".to_owned(), "-oa.png".to_owned()].iter().chain(&names));
    assert!(
        run.code == 2 && run.stderr.contains("1001 photographs") && run.stderr.contains("hdralign batch"),
        "{run:?}"
    );
}

/// A JPEG with padding bytes between segments is searched only once: moving the rest of the file for each of them would
/// copy 10^13 bytes.
#[cfg(unix)]
#[test]
fn padded_jpeg_is_read_in_little_time() {
    let folder = Folder::with_bracket();
    let padding = [0, 0xFF, 0x01].repeat(3_000_000);
    let whole = small_jpeg(3);
    folder.put("padded.jpg", &[&whole[..20], &padding, &whole[20..]].concat());
    within(&folder, ADDRESSES, "merge w2.jpg padded.jpg --align none --threads 2 -q -o padded.png").done();
    folder.line("merge w2.jpg w3.jpg --align none -q -o plain.png").done();
    assert!(folder.bytes("padded.png") == folder.bytes("plain.png"));
}

/// With less and less memory, a run leaves the complete result or no file. The point of failure is different on each
/// machine: before the program is loaded, in the runtime of C or of Rust, or in our allocations.
#[cfg(target_os = "linux")]
#[test]
fn refused_memory_leaves_the_result_or_no_file() {
    let folder = Folder::empty();
    // 900 x 600 pixels: large enough for the memory of the frames to be noticeable beside that of the program.
    for i in 2..=4 {
        let large = image::imageops::resize(&small(i), 900, 600, image::imageops::FilterType::Triangle);
        folder.put(&format!("w{i}.jpg"), &jpeg(&large, Some(i)));
    }
    let before = folder.listing();
    let line = "merge w2.jpg w3.jpg w4.jpg --align none --threads 1 -q -o a.png";
    folder.line(line).done();
    let whole = folder.bytes("a.png");
    // The first limit is enough for the run, and the last not even for the program itself.
    for megabytes in [2000, 90, 60, 45, 1] {
        let _ = fs::remove_file(folder.at("a.png"));
        let script = format!("ulimit -v {} && exec \"$0\" {line}", megabytes * 1000);
        let mut child = Command::new("sh");
        child.args(["-c", &script, env!("CARGO_BIN_EXE_hdralign")]).current_dir(folder.path());
        let is_done = child.stdin(Stdio::null()).output().expect("sh starts").status.success();
        assert!(is_done || megabytes < 2000, "{megabytes} MB");
        assert!(!is_done || megabytes > 1, "{megabytes} MB");
        assert_eq!(folder.at("a.png").exists(), is_done, "{megabytes} MB");
        assert!(!is_done || folder.bytes("a.png") == whole, "{megabytes} MB");
    }
    // Temporary files left by an abort are removed by the next run.
    folder.line(line).done();
    fs::remove_file(folder.at("a.png")).expect("the result");
    assert_eq!(folder.listing(), before);
}

/// A job reads its photographs twice, for their hashes and for their pixels; here a photograph changes between these.
#[test]
fn a_photograph_that_changes_while_a_job_is_done_is_an_error_and_leaves_no_result() {
    let (folder, photographs, _) = card();
    let plan = folder.line("batch . -d out --plan --formats png").done().stdout;
    folder.put("plan.jsonl", plan.as_bytes());
    let jobs = Job::read_all(&folder.at("plan.jsonl")).expect("a plan");
    let (frame, before) = (&photographs[1], fs::read(&photographs[1]).expect("a photograph"));
    let change = |progress| {
        if progress == Progress::Begins(Stage::Load) {
            fs::write(frame, [&before[..], b"more"].concat()).expect("written");
        }
        ControlFlow::Continue(())
    };
    let options =
        Options { align: AlignOptions { mode: AlignMode::None, ..AlignOptions::default() }, ..Options::default() };
    let error = job::run(&jobs[0], &options, false, &change).expect_err("it was changed").to_string();
    assert!(error.contains(": was changed while it was read"), "{error}");
    assert!(!jobs[0].outputs[0].exists() && !jobs[0].report.exists());
    // Without a further change the bracket is merged: a JPEG may be followed by any data.
    job::run(&jobs[0], &options, false, &pipeline::unwatched).expect("merged");
    assert!(jobs[0].outputs[0].exists());
}
