//! A board emulated by QEMU.
//!
//! QEMU connects to us, not we to it, so that no port is guessed and the board's first frame is not
//! lost. It runs under a shell that ends it after a time limit, and at once when this program goes
//! away, however that happens.

use std::io::{self, ErrorKind, Read};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use std::{env, thread};

use tactile_core::wire::TrackerKind;

use super::Link;
use super::firmware::{self, FirmwareError, Machine};
use super::tcp::Tcp;

pub(super) const EMULATOR: &str = "qemu-system-arm";
/// Starts the emulator; ends it when standard input closes or $LIMIT seconds are over.
const GUARD: &str = r#"exec 3<&0
"$@" </dev/null & emulator=$!
(timeout "$LIMIT" cat <&3 >/dev/null 2>&1; kill "$emulator") 2>/dev/null & guard=$!
wait "$emulator"; status=$?
kill "$guard" 2>/dev/null
exit "$status""#;
const START: Duration = Duration::from_secs(30);

/// A running emulator and the link to its UART.
pub struct Qemu {
    link: Tcp,
    child: Child,
}

impl Qemu {
    /// Builds the firmware of this dimension and tracker and starts it on an emulated STM32F405, for at most
    /// `limit`.
    ///
    /// # Errors
    /// When something is missing, the build fails or the emulator does not start.
    pub fn build_and_start(
        dimension: usize,
        tracker: TrackerKind,
        limit: Duration,
    ) -> Result<Self, FirmwareError> {
        let image = firmware::image_for(dimension, tracker).ok_or(FirmwareError::Missing {
            what: "an image with this tracker",
            remedy: "take another tracker",
        })?;
        let elf = firmware::build(image, Machine::Stm32f405)?;
        Self::start(&elf, Machine::Stm32f405, limit)
    }

    /// Starts an image, for at most `limit`.
    ///
    /// # Errors
    /// When the emulator is missing or does not start.
    pub fn start(elf: &Path, machine: Machine, limit: Duration) -> Result<Self, FirmwareError> {
        find_emulator()?;
        let listener =
            TcpListener::bind(("127.0.0.1", 0)).map_err(FirmwareError::io("open a local port"))?;
        let address = listener.local_addr().map_err(FirmwareError::io("open a local port"))?;
        let mut child = Command::new("sh")
            .args(["-c", GUARD, "sh", EMULATOR, "-machine", machine.qemu(), "-display", "none"])
            .args(["-monitor", "none", "-serial", &format!("tcp:{address},nodelay=on")])
            .arg("-kernel")
            .arg(elf)
            .env("LIMIT", limit.as_secs().max(1).to_string())
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(FirmwareError::io("start QEMU"))?;
        match accept(&listener, &mut child) {
            Ok(link) => Ok(Qemu { link, child }),
            Err(error) => {
                end(&mut child);
                Err(error)
            }
        }
    }
}

fn find_emulator() -> Result<(), FirmwareError> {
    let path = env::var_os("PATH").unwrap_or_default();
    let needed =
        [(EMULATOR, "`apt-get install qemu-system-arm`"), ("timeout", "install GNU coreutils")];
    for (what, remedy) in needed {
        if !env::split_paths(&path).any(|d| d.join(what).is_file()) {
            return Err(FirmwareError::Missing { what, remedy });
        }
    }
    Ok(())
}

/// What makes the emulator translate instructions one by one, so that its log has every one: the
/// option was renamed in QEMU 8.1, and the old name dropped in 9.0.
pub(super) fn one_by_one() -> Result<&'static [&'static str], FirmwareError> {
    find_emulator()?;
    let output = Command::new(EMULATOR)
        .arg("--version")
        .output()
        .map_err(FirmwareError::io("ask QEMU for its version"))?;
    Ok(option_of(&String::from_utf8_lossy(&output.stdout)))
}

/// By what `--version` says: `QEMU emulator version 8.2.2 (…)`.
fn option_of(version: &str) -> &'static [&'static str] {
    let mut numbers = version
        .split_once("version ")
        .map_or("", |(_, numbers)| numbers)
        .split(|c: char| !c.is_ascii_digit())
        .map(|number| number.parse::<u32>().unwrap_or(0));
    let version = (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0));
    if ((1, 0)..(8, 1)).contains(&version) {
        &["-singlestep"]
    } else {
        &["-accel", "tcg,one-insn-per-tb=on"]
    }
}

/// Waits for the emulator to connect.
fn accept(listener: &TcpListener, child: &mut Child) -> Result<Tcp, FirmwareError> {
    let failed = || FirmwareError::io("connect QEMU");
    listener.set_nonblocking(true).map_err(failed())?;
    let deadline = Instant::now() + START;
    loop {
        match listener.accept() {
            Ok((stream, _)) => return Tcp::new(stream).map_err(failed()),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(failed()(error)),
        }
        let stopped = child.try_wait().map_err(failed())?.is_some();
        if stopped || Instant::now() > deadline {
            end(child);
            let mut said = String::new();
            if let Some(stderr) = &mut child.stderr {
                let _ = stderr.read_to_string(&mut said);
            }
            return Err(FirmwareError::Stopped(match said.trim() {
                "" => "it did not connect".into(),
                said => said.into(),
            }));
        }
        thread::sleep(Duration::from_millis(5));
    }
}

/// Closes standard input, upon which the guard ends the emulator, and waits for both.
fn end(child: &mut Child) {
    drop(child.stdin.take());
    let _ = child.wait();
}

impl Drop for Qemu {
    fn drop(&mut self) {
        end(&mut self.child);
    }
}

impl Link for Qemu {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.link.send(bytes)
    }

    fn receive(&mut self, bytes: &mut [u8], timeout: Duration) -> io::Result<usize> {
        self.link.receive(bytes, timeout)
    }
}

/// Runs an image that prints through semihosting and exits by itself; with `count` every
/// instruction takes the same emulated time. Returns what it printed.
///
/// # Errors
/// When the emulator is missing, the image fails or `limit` is over.
pub fn run(
    elf: &Path,
    machine: Machine,
    count: bool,
    limit: Duration,
) -> Result<String, FirmwareError> {
    find_emulator()?;
    let mut command = Command::new("timeout");
    command
        .arg(limit.as_secs().max(1).to_string())
        .args([EMULATOR, "-machine", machine.qemu(), "-display", "none", "-monitor", "none"])
        .args(["-serial", "null", "-semihosting-config", "enable=on,target=native"]);
    if count {
        command.args(["-icount", "shift=10,sleep=off"]);
    }
    let output = command
        .arg("-kernel")
        .arg(elf)
        .stdin(Stdio::null())
        .output()
        .map_err(FirmwareError::io("start QEMU"))?;
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    if output.status.success() {
        return Ok(printed);
    }
    let reason = match output.status.code() {
        Some(124) => format!("not done after {} s", limit.as_secs()),
        _ => String::from_utf8_lossy(&output.stderr).trim().to_owned(),
    };
    Err(FirmwareError::Stopped(format!("{reason}\n{printed}")))
}

#[cfg(test)]
mod tests {
    use super::option_of;

    #[test]
    fn the_option_is_that_of_the_version() {
        for (version, option) in [
            (
                "QEMU emulator version 7.2.22 (Debian 1:7.2+dfsg-7+deb12u18)\nCopyright",
                "-singlestep",
            ),
            ("QEMU emulator version 8.0.5", "-singlestep"),
            ("QEMU emulator version 8.1.0", "-accel"),
            ("QEMU emulator version 10.0.2 (v10.0.2)", "-accel"),
            ("something else", "-accel"),
        ] {
            assert_eq!(option_of(version)[0], option, "{version}");
        }
    }
}
