//! Compiles `shaders/*.wgsl` to SPIR-V: `surface.wgsl` once for every variant, the others once per entry point.

use std::collections::HashMap;
use std::fmt::Write as _;
use std::path::Path;

include!("src/variant.rs");

fn main() {
    let shaders = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shaders");
    println!("cargo:rerun-if-changed={}", shaders.display());
    println!("cargo:rerun-if-changed=src/variant.rs");
    println!("cargo:rerun-if-changed=build.rs");
    let mut files: Vec<_> = std::fs::read_dir(&shaders)
        .unwrap_or_else(|error| panic!("{}: {error}", shaders.display()))
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .filter(|path| path.extension().is_some_and(|extension| extension == "wgsl"))
        .collect();
    files.sort();
    let mut blob = Blob::default();
    let mut generated = String::new();
    let read = |file: &Path| {
        std::fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
    };
    let texts: Vec<(&Path, String)> = files.iter().map(|file| (file.as_path(), read(file))).collect();
    let included: Vec<_> = texts.iter().flat_map(|(_, text)| text.lines().filter_map(include)).collect();
    for (file, text) in &texts {
        // What others include has no entry point of its own.
        if file.file_name().and_then(|name| name.to_str()).is_some_and(|name| included.contains(&name)) {
            continue;
        }
        let text = &text
            .lines()
            .map(|line| include(line).map_or(line.to_owned(), |other| read(&shaders.join(other))) + "\n")
            .collect::<String>();
        let name = file.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default().to_owned();
        if name == "surface" {
            surfaces(file, text, &mut blob, &mut generated);
        } else {
            for (entry, words) in compile(file, text, None) {
                let (start, end) = blob.add(&words);
                let constant = format!("{name}_{entry}").to_uppercase();
                writeln!(
                    generated,
                    "/// `{entry}` of `shaders/{name}.wgsl`.\npub const {constant}: Shader = Shader {{ entry: \
                     \"{entry}\", start: {start}, end: {end} }};"
                )
                .expect("writing to a string does not fail");
            }
        }
    }
    let bytes: Vec<u8> = blob.words.iter().flat_map(|word| word.to_le_bytes()).collect();
    let out = std::env::var_os("OUT_DIR").map(std::path::PathBuf::from).expect("cargo sets OUT_DIR");
    std::fs::write(out.join("shaders.spv"), bytes).expect("OUT_DIR is writable");
    std::fs::write(out.join("shaders.rs"), generated).expect("OUT_DIR is writable");
}

/// The file that a line stands for: `//#include FILE`.
fn include(line: &str) -> Option<&str> {
    line.trim().strip_prefix("//#include ").map(str::trim)
}

/// SPIR-V modules one after the other, equal ones once.
#[derive(Default)]
struct Blob {
    words: Vec<u32>,
    known: HashMap<Vec<u32>, (usize, usize)>,
}

impl Blob {
    fn add(&mut self, words: &[u32]) -> (usize, usize) {
        if let Some(range) = self.known.get(words) {
            return *range;
        }
        let range = (self.words.len(), self.words.len() + words.len());
        self.words.extend_from_slice(words);
        self.known.insert(words.to_vec(), range);
        range
    }
}

fn surfaces(file: &Path, text: &str, blob: &mut Blob, generated: &mut String) {
    for (table, stage, variants) in [
        ("SURFACE_VERTEX_VARIANTS", "VERTEX", Variant::all_vertex()),
        ("SURFACE_FRAGMENT_VARIANTS", "FRAGMENT", Variant::all_fragment()),
    ] {
        // naga is the slow part: one thread for each processor.
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        let chunk = variants.len().div_ceil(threads).max(1);
        let compiled: Vec<(u32, Vec<u32>)> = std::thread::scope(|scope| {
            let workers: Vec<_> = variants
                .chunks(chunk)
                .map(|chunk| {
                    scope.spawn(move || {
                        let one = |variant: &Variant| {
                            let mut flags = variant.flags();
                            flags.push(stage);
                            let text = keep(file, text, &flags);
                            let mut modules = compile(file, &text, Some(&flags));
                            assert_eq!(modules.len(), 1, "{}: one entry point in {flags:?}", file.display());
                            (variant.key(), modules.remove(0).1)
                        };
                        chunk.iter().map(one).collect::<Vec<_>>()
                    })
                })
                .collect();
            workers.into_iter().flat_map(|worker| worker.join().expect("a variant compiles")).collect()
        });
        let mut rows: Vec<_> = compiled.iter().map(|(key, words)| (*key, blob.add(words))).collect();
        rows.sort_unstable();
        writeln!(generated, "static {table}: &[(u32, u32, u32)] = &[").expect("writing to a string");
        for (key, (start, end)) in rows {
            writeln!(generated, "    ({key}, {start}, {end}),").expect("writing to a string");
        }
        writeln!(generated, "];").expect("writing to a string");
    }
}

/// The lines of `text` that a variant keeps: `//#if FLAG` … `//#endif`, which nest.
fn keep(file: &Path, text: &str, flags: &[&str]) -> String {
    let mut kept = String::with_capacity(text.len());
    let mut open: Vec<bool> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        if let Some(flag) = line.trim().strip_prefix("//#if ") {
            open.push(flags.contains(&flag.trim()));
        } else if line.trim() == "//#endif" {
            assert!(open.pop().is_some(), "{}:{}: #endif without #if", file.display(), number + 1);
        } else if open.iter().all(|&open| open) {
            kept.push_str(line);
        }
        // Line numbers stay those of the file with what it includes.
        kept.push('\n');
    }
    assert!(open.is_empty(), "{}: #if without #endif", file.display());
    kept
}

/// The SPIR-V of each entry point.
fn compile(file: &Path, text: &str, flags: Option<&[&str]>) -> Vec<(String, Vec<u32>)> {
    let fail = |message: String| -> ! { panic!("{} {flags:?}: {message}", file.display()) };
    let mut module =
        naga::front::wgsl::parse_str(text).unwrap_or_else(|error| fail(error.emit_to_string(text)));
    naga::compact::compact(&mut module, naga::compact::KeepUnused::No);
    let capabilities = naga::valid::Capabilities::MULTIVIEW | naga::valid::Capabilities::IMMEDIATES;
    let info = naga::valid::Validator::new(naga::valid::ValidationFlags::all(), capabilities)
        .validate(&module)
        .unwrap_or_else(|error| fail(error.emit_to_string(text)));
    let options = naga::back::spv::Options {
        lang_version: (1, 3),
        // Neither is the y axis turned over (the projection is Vulkan's already) nor are names kept.
        flags: naga::back::spv::WriterFlags::empty(),
        // Loops end: their bounds are constants.
        force_loop_bounding: false,
        ..Default::default()
    };
    let entries = module.entry_points.iter().map(|entry| (entry.name.clone(), entry.stage));
    entries
        .map(|(name, stage)| {
            let pipeline =
                naga::back::spv::PipelineOptions { shader_stage: stage, entry_point: name.clone() };
            let words = naga::back::spv::write_vec(&module, &info, &options, Some(&pipeline))
                .unwrap_or_else(|error| fail(error.to_string()));
            (name, words)
        })
        .collect()
}
