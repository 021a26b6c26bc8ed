//! Builds firmware images from the workspace this program was built in.

use std::env;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;

use tactile_core::wire::TrackerKind;

/// What the images are compiled for.
const TARGET: &str = "thumbv7em-none-eabihf";
/// Debian's toolchain, beside which rustup's may also exist.
const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_CLIPPY: &str = "/usr/bin/cargo-clippy";
const DEBIAN_LLD: &str = "/usr/bin/ld.lld";
const DEBIAN_SOURCES: &str = "/usr/lib/rustlib/src/rust/library/core/Cargo.toml";

/// Why there is no running firmware.
#[derive(Debug, thiserror::Error)]
pub enum FirmwareError {
    /// Something that has to be installed is not.
    #[error("{what} is missing: {remedy}")]
    Missing {
        /// What.
        what: &'static str,
        /// How to get it.
        remedy: &'static str,
    },
    /// The sources are not where they were.
    #[error(
        "no firmware sources at {}: run from a checkout, or name one in TACTILE_WORKSPACE", .0.display()
    )]
    NoWorkspace(PathBuf),
    /// The compiler refused.
    #[error("compiling {image} for {machine} failed:\n{log}")]
    Build {
        /// Which image.
        image: String,
        /// Which board.
        machine: &'static str,
        /// What the compiler said last.
        log: String,
    },
    /// A file or a process.
    #[error("cannot {action}: {source}")]
    Io {
        /// What was tried.
        action: String,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The image is not a 32-bit little-endian ELF file.
    #[error("{}: not an image of this target", .0.display())]
    Image(PathBuf),
    /// The emulator gave up.
    #[error("QEMU stopped: {0}")]
    Stopped(String),
}

impl FirmwareError {
    /// Whether something has to be installed first: a test may then be skipped.
    pub fn is_missing(&self) -> bool {
        matches!(self, FirmwareError::Missing { .. })
    }

    pub(super) fn io(action: impl Into<String>) -> impl FnOnce(std::io::Error) -> Self {
        let action = action.into();
        |source| FirmwareError::Io { action, source }
    }
}

/// A board that QEMU emulates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Machine {
    /// STM32F405: the image is the one for silicon.
    Stm32f405,
    /// ARM MPS2 AN386: counts instructions.
    Mps2An386,
}

impl Machine {
    /// The firmware's feature.
    pub fn feature(self) -> &'static str {
        match self {
            Machine::Stm32f405 => "stm32f405",
            Machine::Mps2An386 => "mps2-an386",
        }
    }

    /// QEMU's name.
    pub fn qemu(self) -> &'static str {
        match self {
            Machine::Stm32f405 => "netduinoplus2",
            Machine::Mps2An386 => "mps2-an386",
        }
    }
}

/// Every image with a tracker: its name, the dimension and how it follows the object.
pub const IMAGES: [(&str, usize, TrackerKind); 12] = [
    ("planar", 2, TrackerKind::Bootstrap),
    ("spatial", 3, TrackerKind::Bootstrap),
    ("planar-hypotheses", 2, TrackerKind::Hypotheses),
    ("spatial-hypotheses", 3, TrackerKind::Hypotheses),
    ("planar-rao-blackwell", 2, TrackerKind::RaoBlackwell),
    ("spatial-rao-blackwell", 3, TrackerKind::RaoBlackwell),
    ("planar-curved", 2, TrackerKind::Curved),
    ("spatial-curved", 3, TrackerKind::Curved),
    ("planar-automatic", 2, TrackerKind::Automatic),
    ("spatial-automatic", 3, TrackerKind::Automatic),
    (SENSING, 3, TrackerKind::Hypotheses),
    (GAUGES, 3, TrackerKind::Hypotheses),
];

/// The image whose fingertips have sensors that a host scripts.
pub const SENSING: &str = "spatial-sensing";
/// The image that reads five ADS131M08 over `SPI1`: for the STM32F405 only.
pub const GAUGES: &str = "spatial-gauges";

/// The images that print what the core costs, of trackers and of sensors: for the AN386 only.
pub const BENCHES: [&str; 3] = ["bench", "bench-map", "bench-sensing"];

/// The image without sensors that follows objects so in this many dimensions; `None` where there is
/// none.
pub fn image_for(dimension: usize, tracker: TrackerKind) -> Option<&'static str> {
    IMAGES.iter().find(|i| (i.1, i.2) == (dimension, tracker)).map(|i| i.0)
}

/// The checkout: `$TACTILE_WORKSPACE`, or where this program was built.
///
/// # Errors
/// When there are no firmware sources.
pub fn workspace() -> Result<PathBuf, FirmwareError> {
    let root = match env::var_os("TACTILE_WORKSPACE") {
        Some(root) => PathBuf::from(root),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join(".."),
    };
    if root.join("firmware/Cargo.toml").is_file() {
        fs::canonicalize(&root).map_err(FirmwareError::io(format!("open {}", root.display())))
    } else {
        Err(FirmwareError::NoWorkspace(root))
    }
}

/// Who compiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Toolchain {
    /// rustup's, with the target installed.
    Rustup,
    /// Debian's, which builds `core` itself.
    Debian,
}

impl Toolchain {
    fn find() -> Result<Self, FirmwareError> {
        let directory = Command::new("rustc")
            .args(["--print", "target-libdir", "--target", TARGET])
            .output()
            .ok()
            .filter(|o| o.status.success())
            .map(|o| PathBuf::from(String::from_utf8_lossy(&o.stdout).trim()));
        let has_core = directory.and_then(|d| fs::read_dir(d).ok()).is_some_and(|mut entries| {
            entries
                .any(|e| e.is_ok_and(|e| e.file_name().to_string_lossy().starts_with("libcore-")))
        });
        let debian = [DEBIAN_CARGO, DEBIAN_RUSTC, DEBIAN_LLD, DEBIAN_SOURCES];
        if has_core {
            Ok(Toolchain::Rustup)
        } else if debian.iter().all(|p| Path::new(p).exists()) {
            Ok(Toolchain::Debian)
        } else {
            Err(FirmwareError::Missing {
                what: "a compiler for thumbv7em-none-eabihf",
                remedy: "`rustup target add thumbv7em-none-eabihf`, or on Debian \
                         `apt-get install rustc-web cargo-web rust-web-src lld`",
            })
        }
    }

    /// Cargo, or clippy in cargo's place, without the first argument.
    fn command(self, clippy: bool) -> Command {
        let mut command = Command::new(match self {
            Toolchain::Rustup => "cargo",
            // By its path: rustup's proxy of the same name would otherwise be found first.
            Toolchain::Debian if clippy => DEBIAN_CLIPPY,
            Toolchain::Debian => DEBIAN_CARGO,
        });
        // What an outer cargo has set would reach the inner one: its flags replace the linker
        // script's, its toolchain the one chosen here.
        let kept =
            ["CARGO_HOME", "CARGO_NET_", "CARGO_HTTP_", "CARGO_REGISTRIES_", "CARGO_BUILD_JOBS"];
        for (name, _) in env::vars_os() {
            let name = name.to_string_lossy().into_owned();
            let rust = name == "RUSTFLAGS" || name == "RUSTC" || name.starts_with("CARGO");
            let rustup = name.starts_with("RUSTUP") && self == Toolchain::Debian;
            if (rust || rustup) && !kept.iter().any(|k| name.starts_with(k)) {
                command.env_remove(name);
            }
        }
        if self == Toolchain::Debian {
            command
                .env("CARGO", DEBIAN_CARGO)
                .env("RUSTC", DEBIAN_RUSTC)
                .env("RUSTC_BOOTSTRAP", "1")
                .env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", DEBIAN_LLD);
        }
        command
    }
}

/// Builds an image and returns the path of its ELF file. Images of different boards do not
/// overwrite each other, and builds of one workspace wait for one another.
///
/// # Errors
/// When compiler or sources are missing, or the compiler refuses.
pub fn build(image: &str, machine: Machine) -> Result<PathBuf, FirmwareError> {
    let workshop = Workshop::open()?;
    workshop.build(&[image], machine)?;
    workshop.kept(image, machine)
}

/// Builds several images, which occupies more processors than one does: they are there when
/// [`build`] is asked for them.
///
/// # Errors
/// As [`build`]'s.
pub fn build_ahead(images: &[&str], machine: Machine) -> Result<(), FirmwareError> {
    Workshop::open()?.build(images, machine)
}

/// Checks core and firmware with clippy for the board's target; warnings are errors.
///
/// # Errors
/// When compiler, clippy or sources are missing, or clippy finds something.
pub fn clippy(machine: Machine) -> Result<(), FirmwareError> {
    let workshop = Workshop::open()?;
    if workshop.toolchain == Toolchain::Debian && !Path::new(DEBIAN_CLIPPY).exists() {
        return Err(FirmwareError::Missing {
            what: "clippy for Debian's compiler",
            remedy: "`apt-get install rust-web-clippy`",
        });
    }
    let mut command = workshop.toolchain.command(true);
    command.args(["clippy", "--package", "tactile-core", "--package", "tactile-firmware"]);
    // Only one board counts instructions.
    match machine {
        Machine::Stm32f405 => {
            command.arg("--lib").args(IMAGES.iter().flat_map(|(name, ..)| ["--bin", name]))
        }
        Machine::Mps2An386 => command.args(["--lib", "--bins"]),
    };
    let features = match machine {
        Machine::Stm32f405 => "",
        Machine::Mps2An386 => "semihosting",
    };
    workshop.run(command, "all images", machine, features, &["--", "-D", "warnings"])
}

/// Sources, compiler and target folder, locked while in use.
struct Workshop {
    root: PathBuf,
    target: PathBuf,
    toolchain: Toolchain,
    _lock: File,
}

impl Workshop {
    fn open() -> Result<Self, FirmwareError> {
        let root = workspace()?;
        let toolchain = Toolchain::find()?;
        let target = match env::var_os("CARGO_TARGET_DIR") {
            Some(directory) => PathBuf::from(directory),
            None => root.join("target"),
        };
        let target = std::path::absolute(target.join("firmware"))
            .map_err(FirmwareError::io("find the target folder"))?;
        let path = target.join("build.lock");
        let lock = fs::create_dir_all(&target)
            .and_then(|()| File::create(&path))
            .and_then(|file| file.lock().map(|()| file))
            .map_err(FirmwareError::io(format!("write {}", path.display())))?;
        Ok(Workshop { root, target, toolchain, _lock: lock })
    }

    fn build(&self, images: &[&str], machine: Machine) -> Result<(), FirmwareError> {
        let mut command = self.toolchain.command(false);
        command.args(["build", "--package", "tactile-firmware", "--profile", "firmware"]);
        command.args(images.iter().flat_map(|image| ["--bin", image]));
        let is_bench = images.iter().any(|image| BENCHES.contains(image));
        let features = if is_bench { "semihosting" } else { "" };
        self.run(command, &images.join(", "), machine, features, &[])
    }

    /// A copy of what was built that no other board's image replaces.
    fn kept(&self, image: &str, machine: Machine) -> Result<PathBuf, FirmwareError> {
        let images = self.target.join("images");
        let describe = |path: &Path| format!("write {}", path.display());
        fs::create_dir_all(&images).map_err(FirmwareError::io(describe(&images)))?;
        let built = self.target.join(TARGET).join("firmware").join(image);
        let elf = images.join(format!("{image}-{}.elf", machine.feature()));
        let fresh = images.join(format!("{image}-{}.new", machine.feature()));
        fs::copy(&built, &fresh)
            .and_then(|_| fs::rename(&fresh, &elf))
            .map_err(FirmwareError::io(describe(&elf)))?;
        Ok(elf)
    }

    /// Adds what every command needs and runs it.
    fn run(
        &self,
        mut command: Command,
        image: &str,
        machine: Machine,
        features: &str,
        last: &[&str],
    ) -> Result<(), FirmwareError> {
        command.current_dir(&self.root).args(["--target", TARGET, "--no-default-features"]);
        let board = machine.feature();
        let features = format!(
            "tactile-firmware/{board}{}",
            match features {
                "" => String::new(),
                more => format!(",tactile-firmware/{more}"),
            }
        );
        command.arg("--features").arg(features).arg("--target-dir").arg(&self.target);
        if self.toolchain == Toolchain::Debian {
            command.arg("-Zbuild-std=core");
        }
        let output = command.args(last).output().map_err(FirmwareError::io("start cargo"))?;
        if output.status.success() {
            return Ok(());
        }
        let log = String::from_utf8_lossy(&output.stderr);
        let lines: Vec<&str> = log.lines().collect();
        let log = lines.get(lines.len().saturating_sub(60)..).unwrap_or(&[]).join("\n");
        Err(FirmwareError::Build { image: image.into(), machine: board, log })
    }
}

/// What an image occupies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Footprint {
    /// Code, constants and initial values, bytes.
    pub flash: u32,
    /// Static memory, bytes; of it `initialised` also takes flash.
    pub ram: u32,
    /// Static memory that does not start as zero, bytes.
    pub initialised: u32,
}

/// Adds up the sections of an image.
///
/// # Errors
/// When the file is not an image.
pub fn footprint(elf: &Path) -> Result<Footprint, FirmwareError> {
    let bytes = fs::read(elf).map_err(FirmwareError::io(format!("read {}", elf.display())))?;
    sections(&bytes).ok_or_else(|| FirmwareError::Image(elf.into()))
}

fn sections(elf: &[u8]) -> Option<Footprint> {
    let word = |at: usize| Some(u32::from_le_bytes(*elf.get(at..)?.first_chunk()?));
    let half = |at: usize| Some(u16::from_le_bytes(*elf.get(at..)?.first_chunk()?));
    // 32 bits, least significant byte first.
    if !elf.starts_with(b"\x7fELF\x01\x01") {
        return None;
    }
    let (table, size, count) = (word(0x20)? as usize, half(0x2e)? as usize, half(0x30)? as usize);
    let mut total = Footprint::default();
    for section in (0..count).map(|i| table + i * size) {
        let (kind, flags, bytes) = (word(section + 4)?, word(section + 8)?, word(section + 20)?);
        let (allocated, writable, empty) = (flags & 2 != 0, flags & 1 != 0, kind == 8);
        if allocated {
            total.flash += if empty { 0 } else { bytes };
            total.ram += if writable { bytes } else { 0 };
            total.initialised += if writable && !empty { bytes } else { 0 };
        }
    }
    Some(total)
}
