//! How many cycles a Cortex-M4F would take for what QEMU executes: a model, not a measurement.
//!
//! The image marks what it counts by `SEV` before and after. QEMU says which address every
//! instruction executed lies at, the ELF file what stands there, and this table what that costs
//! (Cortex-M4 Technical Reference Manual r0p1, tables 3-1 and 7-1, sections 3.3.2 and 7.2.3):
//!
//! | instruction | cycles |
//! |---|---|
//! | arithmetic, moves, comparisons, `IT`, also of the FPU | 1 |
//! | load or store of one register | 2; 1 straight after another of these |
//! | of N registers, `push`, `pop` | 1 + N |
//! | `sdiv`, `udiv` | 12, the longest |
//! | multiply and accumulate of the FPU | 3 |
//! | `vdiv`, `vsqrt` | 14 |
//! | a branch not taken; taken, or a `pop` into the program counter | 1; 2 more |
//! | an FPU result that the next instruction takes | 1 more |
//!
//! Flash is taken to answer at once, as an STM32F4's cache lets it for loops. Integer instructions
//! that could run beside a division are not credited.

use std::collections::HashMap;
use std::fmt::Write;
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use std::{fs, str};

use super::firmware::{FirmwareError, Machine};
use super::qemu;

/// What stands at an address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Instruction {
    /// Bytes: 2 or 4.
    pub size: u32,
    /// What it costs.
    pub kind: Kind,
    /// The FPU register it writes by arithmetic, and those it reads.
    target: Option<u8>,
    sources: [Option<u8>; 2],
}

/// Instructions that cost alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// One cycle.
    Single,
    /// A load or store of one register.
    Transfer,
    /// A load or store of so many words.
    Transfers(u32),
    /// An integer division.
    Division,
    /// Multiply and accumulate in the FPU.
    Accumulate,
    /// Division or square root in the FPU.
    Root,
    /// The mark around what is counted.
    Mark,
}

impl Instruction {
    /// Decodes the Thumb instruction that begins with `first`; `second` is used where it is long.
    pub fn decode(first: u16, second: u16) -> Self {
        let plain = |size, kind| Instruction { size, kind, target: None, sources: [None; 2] };
        let (a, b) = (u32::from(first), u32::from(second));
        if a >> 11 < 0b11101 {
            return plain(2, narrow(a));
        }
        if a & 0xef00 != 0xee00 || b & 0x0e00 != 0x0a00 {
            return match floating_transfer(a, b) {
                Some(kind) => plain(4, kind),
                None => plain(4, wide(a, b)),
            };
        }
        // Coprocessor 10: arithmetic, or one register to or from the core's.
        if b & 0x10 != 0 {
            return plain(4, Kind::Single);
        }
        let register = |high: u32, low: u32| Some((high << 1 | low & 1) as u8);
        let destination = register(b >> 12 & 15, a >> 6);
        let (n, m) = (register(a & 15, b >> 7), register(b & 15, b >> 5));
        let opcode = (a >> 7 & 1) << 2 | (a >> 4 & 3);
        let (kind, sources) = match opcode {
            0 | 1 | 5 | 6 => (Kind::Accumulate, [n, m]),
            4 => (Kind::Root, [n, m]),
            7 => match (a & 15, b >> 6 & 3) {
                // Immediates and copies are no arithmetic.
                (_, 0 | 2) | (0, 1) => return plain(4, Kind::Single),
                (1, 3) => (Kind::Root, [m, None]),
                // Comparisons, with a register or zero, write flags.
                (compared @ (4 | 5), _) => {
                    let sources = [destination, m.filter(|_| compared == 4)];
                    return Instruction { sources, ..plain(4, Kind::Single) };
                }
                _ => (Kind::Single, [m, None]),
            },
            _ => (Kind::Single, [n, m]),
        };
        Instruction { size: 4, kind, target: destination, sources }
    }
}

fn narrow(a: u32) -> Kind {
    match a {
        0xbf40 => Kind::Mark,
        // push, pop; with the link register or the program counter.
        _ if a & 0xf600 == 0xb400 => Kind::Transfers((a & 0x1ff).count_ones()),
        _ if a >> 12 == 0b1100 => Kind::Transfers((a & 0xff).count_ones()),
        // Literals, register offsets, immediate offsets, the stack.
        _ if a >> 11 == 0b01001 || a >> 12 == 0b0101 => Kind::Transfer,
        _ if matches!(a >> 12, 0b0110..=0b1001) => Kind::Transfer,
        _ => Kind::Single,
    }
}

fn wide(a: u32, b: u32) -> Kind {
    if a & 0xfe40 == 0xe800 {
        Kind::Transfers(b.count_ones())
    } else if a & 0xfff0 == 0xe8d0 || a & 0xfe00 == 0xf800 {
        // `tbb` and `tbh` load one number, too.
        Kind::Transfer
    } else if a & 0xfe40 == 0xe840 {
        Kind::Transfers(2)
    } else if a & 0xffd0 == 0xfb90 && b & 0xf0 == 0xf0 {
        Kind::Division
    } else {
        Kind::Single
    }
}

/// `vldr`, `vstr`, `vldm`, `vstm`, `vpush`, `vpop`.
fn floating_transfer(a: u32, b: u32) -> Option<Kind> {
    if a & 0xfe00 != 0xec00 || b & 0x0e00 != 0x0a00 || a & 0x01e0 == 0x0040 {
        return None;
    }
    let double = b >> 8 & 1 != 0;
    Some(match (a & 0x0120 == 0x0100, double) {
        (true, false) => Kind::Transfer,
        (true, true) => Kind::Transfers(2),
        (false, _) => Kind::Transfers(b & 0xff),
    })
}

/// Adds up what instructions cost in the order of their execution.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Executed.
    pub instructions: u64,
    /// Modelled.
    pub cycles: u64,
    /// Whether the last was one that pipelines with the next of its kind, the FPU register it
    /// wrote, and where the next stands if it did not branch.
    transferred: bool,
    written: Option<u8>,
    next: Option<u32>,
}

impl Tally {
    /// Takes the instruction at `address`.
    pub fn add(&mut self, address: u32, instruction: &Instruction) {
        if self.next.is_some_and(|next| next != address) {
            self.cycles += 2;
        }
        if self.written.is_some() && instruction.sources.contains(&self.written) {
            self.cycles += 1;
        }
        self.cycles += match instruction.kind {
            Kind::Single | Kind::Mark => 1,
            Kind::Transfer => 2 - u64::from(self.transferred),
            Kind::Transfers(count) => 1 + u64::from(count),
            Kind::Division => 12,
            Kind::Accumulate => 3,
            Kind::Root => 14,
        };
        self.instructions += 1;
        self.transferred = instruction.kind == Kind::Transfer;
        self.written = instruction.target;
        self.next = Some(address.wrapping_add(instruction.size));
    }
}

/// What an image holds at which address.
struct Program(Vec<(u32, Vec<u8>)>);

impl Program {
    fn open(elf: &Path) -> Result<Self, FirmwareError> {
        let bytes = fs::read(elf).map_err(FirmwareError::io(format!("read {}", elf.display())))?;
        Self::parse(&bytes).ok_or_else(|| FirmwareError::Image(elf.into()))
    }

    fn parse(elf: &[u8]) -> Option<Self> {
        let word = |at: usize| Some(u32::from_le_bytes(*elf.get(at..)?.first_chunk()?));
        let half = |at: usize| Some(u16::from_le_bytes(*elf.get(at..)?.first_chunk()?));
        if !elf.starts_with(b"\x7fELF\x01\x01") {
            return None;
        }
        let (table, size, count) = (word(0x1c)? as usize, half(0x2a)?, half(0x2c)?);
        let mut segments = Vec::new();
        for header in (0..usize::from(count)).map(|i| table + i * usize::from(size)) {
            // Loaded: where in the file, where in memory, how long.
            if word(header)? == 1 {
                let (from, to, long) = (word(header + 4)?, word(header + 8)?, word(header + 16)?);
                let (from, long) = (from as usize, long as usize);
                segments.push((to, elf.get(from..from.checked_add(long)?)?.to_vec()));
            }
        }
        Some(Program(segments))
    }

    fn at(&self, address: u32) -> Option<Instruction> {
        let half = |address: u32| {
            self.0.iter().find_map(|(start, bytes)| {
                let from = address.checked_sub(*start)? as usize;
                Some(u16::from_le_bytes(*bytes.get(from..)?.first_chunk()?))
            })
        };
        Some(Instruction::decode(half(address)?, half(address.wrapping_add(2)).unwrap_or(0)))
    }
}

/// Runs an image that counts, instruction by instruction; its table with a second column: modelled
/// cycles.
///
/// # Errors
/// When the emulator is missing or fails, `limit` is over, or the trace has not as many counts as
/// the table.
pub fn run(elf: &Path, machine: Machine, limit: Duration) -> Result<String, FirmwareError> {
    let printed = qemu::run(elf, machine, true, limit)?;
    let counts = trace(&Program::open(elf)?, elf, machine, limit)?;
    table(&printed, &counts)
        .ok_or_else(|| FirmwareError::Stopped("the trace is not that of the table".into()))
}

/// What stands between marks, in order.
fn trace(
    program: &Program,
    elf: &Path,
    machine: Machine,
    limit: Duration,
) -> Result<Vec<Tally>, FirmwareError> {
    let mut child = Command::new("timeout")
        .arg(limit.as_secs().max(1).to_string())
        .args([qemu::EMULATOR, "-machine", machine.qemu(), "-display", "none"])
        .args(["-monitor", "none", "-serial", "null", "-d", "exec,nochain"])
        .args(qemu::one_by_one()?)
        .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
        .arg(elf)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(FirmwareError::io("start QEMU"))?;
    let (tallies, said) = match child.stderr.take() {
        Some(log) => read(program, log).map_err(FirmwareError::io("read QEMU's trace"))?,
        None => Default::default(),
    };
    let status = child.wait().map_err(FirmwareError::io("wait for QEMU"))?;
    let stopped = || FirmwareError::Stopped(format!("{status} {said}").trim_end().into());
    if status.success() { Ok(tallies) } else { Err(stopped()) }
}

/// Lines of the log are `Trace 0: 0x7f… [cs_base/pc/flags/cflags] name`. Also the last line that is
/// none of them: why QEMU gave up, if it did.
fn read(program: &Program, log: impl Read) -> std::io::Result<(Vec<Tally>, String)> {
    let mut said = String::new();
    let (mut known, mut tallies) = (HashMap::new(), Vec::new());
    let mut counting: Option<Tally> = None;
    let (mut log, mut line) = (BufReader::new(log), Vec::new());
    while log.read_until(b'\n', &mut line)? > 0 {
        let address = str::from_utf8(&line).ok().and_then(|line| {
            let pc = line.strip_prefix("Trace")?.split_once('[')?.1.split('/').nth(1)?;
            u32::from_str_radix(pc, 16).ok()
        });
        if address.is_none() {
            said = String::from_utf8_lossy(&line).trim().to_owned();
        }
        line.clear();
        let Some(address) = address else { continue };
        let entry = known.entry(address).or_insert_with(|| program.at(address));
        let Some(instruction) = entry else { continue };
        if instruction.kind == Kind::Mark {
            match counting.take() {
                Some(tally) => tallies.push(tally),
                None => counting = Some(Tally::default()),
            }
        } else if let Some(tally) = &mut counting {
            tally.add(address, instruction);
        }
    }
    Ok((tallies, said))
}

/// The image's lines, each count followed by its cycles. The first two tallies are those by which
/// the image finds its own scale.
fn table(printed: &str, tallies: &[Tally]) -> Option<String> {
    let mut tallies = tallies.get(2..)?.iter();
    let mut out = String::from("instructions and modelled cycles, Cortex-M4F\n");
    for line in printed.lines() {
        let counted = line.rsplit_once(' ').is_some_and(|(_, n)| n.parse::<u64>().is_ok());
        match counted {
            true => writeln!(out, "{line} {:>10}", tallies.next()?.cycles),
            false => writeln!(out, "{line}"),
        }
        .ok()?;
    }
    tallies.next().is_none().then_some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instructions_are_told_apart() {
        // As an assembler writes them: first and second half word.
        let kinds = [
            (0xb5f0, 0, 2, Kind::Transfers(5)),       // push {r4-r7, lr}
            (0xbdf0, 0, 2, Kind::Transfers(5)),       // pop {r4-r7, pc}
            (0xe92d, 0x0f00, 4, Kind::Transfers(4)),  // push.w {r8-r11}
            (0xed2d, 0x8b10, 4, Kind::Transfers(16)), // vpush {d8-d15}
            (0x6841, 0, 2, Kind::Transfer),           // ldr r1, [r0, #4]
            (0x4801, 0, 2, Kind::Transfer),           // ldr r0, [pc, #4]
            (0xf8b2, 0x3002, 4, Kind::Transfer),      // ldrh.w r3, [r2, #2]
            (0xf84d, 0x8d04, 4, Kind::Transfer),      // str r8, [sp, #-4]!
            (0xe9d2, 0x0100, 4, Kind::Transfers(2)),  // ldrd r0, r1, [r2]
            (0xed92, 0x0a00, 4, Kind::Transfer),      // vldr s0, [r2]
            (0xed80, 0x0a01, 4, Kind::Transfer),      // vstr s0, [r0, #4]
            (0xfbb0, 0xf0f1, 4, Kind::Division),      // udiv r0, r0, r1
            (0xee85, 0x0a00, 4, Kind::Root),          // vdiv.f32 s0, s10, s0
            (0xeeb1, 0x0ac0, 4, Kind::Root),          // vsqrt.f32 s0, s0
            (0xee00, 0x0a81, 4, Kind::Accumulate),    // vmla.f32 s0, s1, s2
            (0xee20, 0x0a00, 4, Kind::Single),        // vmul.f32 s0, s0, s0
            (0xee10, 0x1a10, 4, Kind::Single),        // vmov r1, s0
            (0xf04f, 0x0201, 4, Kind::Single),        // mov.w r2, #1
            (0x4408, 0, 2, Kind::Single),             // add r0, r1
            (0xbf40, 0, 2, Kind::Mark),               // sev
        ];
        for (first, second, size, kind) in kinds {
            let instruction = Instruction::decode(first, second);
            assert_eq!((instruction.size, instruction.kind), (size, kind), "{first:x} {second:x}");
        }
    }

    #[test]
    fn order_matters() {
        let cycles = |program: &[(u32, u16, u16)]| {
            let mut tally = Tally::default();
            for (address, first, second) in program {
                tally.add(*address, &Instruction::decode(*first, *second));
            }
            (tally.instructions, tally.cycles)
        };
        // Two loads in a row.
        assert_eq!(cycles(&[(0, 0x6841, 0), (2, 0x6882, 0)]), (2, 3));
        // A branch taken, and not.
        assert_eq!(cycles(&[(0, 0xd000, 0), (4, 0x4408, 0)]), (2, 4));
        assert_eq!(cycles(&[(0, 0xd000, 0), (2, 0x4408, 0)]), (2, 2));
        // vmul.f32 s0, s1, s2, then vadd.f32 s3, s0, s1 and vadd.f32 s3, s1, s2.
        assert_eq!(cycles(&[(0, 0xee20, 0x0a81), (4, 0xee70, 0x1a20)]), (2, 3));
        assert_eq!(cycles(&[(0, 0xee20, 0x0a81), (4, 0xee70, 0x1a81)]), (2, 2));
    }

    #[test]
    fn a_table_gets_its_cycles() {
        let tally = |cycles| Tally { cycles, ..Tally::default() };
        let tallies = [tally(1), tally(2), tally(30), tally(40)];
        let printed = "heading:\n  one         20\n  two         25\n";
        let out = table(printed, &tallies).unwrap();
        let lines: Vec<&str> = out.lines().collect();
        assert!(lines[2].ends_with("20         30") && lines[3].ends_with("25         40"));
        assert_eq!(table(printed, &tallies[..3]), None, "one count too many");
        assert_eq!(table("heading:\n", &tallies), None, "no counts");
    }
}
