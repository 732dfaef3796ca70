//! The class of CPU: equal fingerprints give equal bits.
//!
//! The numeric kernels choose their code by what the CPU can do, so the fingerprint is the architecture and the
//! vector extensions that decide, and not the model's name.

/// Returns the fingerprint of this machine, such as `x86_64+avx+avx2+fma`.
pub fn fingerprint() -> String {
    let mut text = std::env::consts::ARCH.to_owned();
    for (name, present) in extensions() {
        if present {
            text.push('+');
            text.push_str(name);
        }
    }
    text
}

#[cfg(target_arch = "x86_64")]
fn extensions() -> Vec<(&'static str, bool)> {
    vec![
        ("avx", std::is_x86_feature_detected!("avx")),
        ("avx2", std::is_x86_feature_detected!("avx2")),
        ("fma", std::is_x86_feature_detected!("fma")),
        ("avx512f", std::is_x86_feature_detected!("avx512f")),
    ]
}

#[cfg(not(target_arch = "x86_64"))]
fn extensions() -> Vec<(&'static str, bool)> {
    Vec::new()
}
