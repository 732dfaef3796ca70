//! What the machine says: memory, disk, the end of a certificate. Read when somebody asks.

use std::fs;
use std::path::Path;

use leadtime_certs::Certificate;
use rustix::fs::{Access, access, statvfs};

/// Returns the memory of this process in bytes.
pub(crate) fn resident_bytes() -> Option<f64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    let kib: f64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024.0)
}

/// Returns how many bytes are free on the disk of a path, and how many it holds.
pub(crate) fn disk_bytes(path: &Path) -> Option<(f64, f64)> {
    let disk = statvfs(path).ok()?;
    let bytes = |blocks: u64| blocks as f64 * disk.f_frsize as f64;
    Some((bytes(disk.f_bavail), bytes(disk.f_blocks)))
}

/// Tells whether files can be made in a directory, as far as its permissions say.
pub(crate) fn is_writable(directory: &Path) -> bool {
    access(directory, Access::WRITE_OK | Access::EXEC_OK).is_ok()
}

/// Returns when a certificate ends, in seconds since 1970.
pub(crate) fn certificate_end(path: &Path) -> Option<f64> {
    Some(Certificate::read(path).ok()?.ends.as_second() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_machine_answers() {
        let directory = tempfile::tempdir().unwrap();
        assert!(resident_bytes().unwrap() > 1e6);
        let (free, size) = disk_bytes(directory.path()).unwrap();
        assert!(0.0 <= free && free <= size, "{free} of {size}");
        assert!(is_writable(directory.path()) && !is_writable(&directory.path().join("no")));
        assert_eq!(certificate_end(&directory.path().join("no.pem")), None);
    }
}
