//! `leadtime version`: what this program speaks and reads.

use leadtime_learner::checkpoint::FORMAT_VERSION;
use leadtime_proto::header::PROTOCOL_VERSION;
use serde_json::json;

use crate::cli::VersionArgs;
use crate::output;

pub(super) fn run(args: &VersionArgs) {
    let version = env!("CARGO_PKG_VERSION");
    if args.protocol {
        output::line(&PROTOCOL_VERSION.to_string());
    } else if args.json {
        output::json(&json!({
            "version": version,
            "protocol": PROTOCOL_VERSION,
            "checkpoint_format": FORMAT_VERSION,
        }));
    } else {
        output::line(&format!(
            "leadtime {version}, protocol {PROTOCOL_VERSION}, checkpoint format {FORMAT_VERSION}"
        ));
    }
}
