//! How much memory this process has taken, as far as Linux tells.

/// The most bytes held in memory at once, since the start or [`forget_peak`]; `None` where the system
/// does not say.
pub fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? * 1024)
}

/// Has the peak begin at what is held now. What was freed before may still be held.
pub fn forget_peak() {
    // Where this is not to be had, the peak is that of the whole process.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_at_least_what_is_held() {
        let Some(before) = peak_memory() else { return };
        let held = vec![1u8; 64 << 20];
        assert!(peak_memory() >= Some(before.max(64 << 20)));
        assert_eq!(held.iter().step_by(4096).map(|&b| b as usize).sum::<usize>(), 16 << 10);
    }
}
