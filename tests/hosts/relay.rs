//! A slow line: what arrives goes on after a delay, in order, in both directions. Not every kernel can delay by itself.

use std::io::{Read as _, Write as _};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// Pieces that are on their way at once; a sender waits beyond that, as on a full line.
const MAX_ON_THE_WAY: usize = 4_096;
/// The largest piece.
const PIECE: usize = 64 << 10;

/// Passes on connections from one address to another, until the process ends.
pub(crate) fn run(listen: &str, target: &str, delay: Duration) {
    let listener = TcpListener::bind(listen).expect("the relay can listen");
    for near in listener.incoming() {
        let Ok(near) = near else { continue };
        let Ok(far) = TcpStream::connect(target) else { continue };
        for stream in [&near, &far] {
            stream.set_nodelay(true).expect("a socket of ours");
        }
        let copies = [&near, &far].map(|stream| stream.try_clone().expect("a socket of ours"));
        let [near_too, far_too] = copies;
        direction(near, far, delay);
        direction(far_too, near_too, delay);
    }
}

fn direction(from: TcpStream, to: TcpStream, delay: Duration) {
    let (sender, pieces) = sync_channel(MAX_ON_THE_WAY);
    let mut source = from;
    let read = move || {
        let mut buffer = vec![0; PIECE];
        while let Ok(n @ 1..) = source.read(&mut buffer) {
            if sender.send((Instant::now() + delay, buffer[..n].to_vec())).is_err() {
                return;
            }
        }
    };
    let write = move || deliver(to, &pieces);
    for (name, work) in
        [("read", Box::new(read) as Box<dyn FnOnce() + Send>), ("write", Box::new(write))]
    {
        thread::Builder::new().name(name.to_owned()).spawn(work).expect("a thread can be made");
    }
}

fn deliver(mut to: TcpStream, pieces: &Receiver<(Instant, Vec<u8>)>) {
    for (due, piece) in pieces {
        thread::sleep(due.saturating_duration_since(Instant::now()));
        if to.write_all(&piece).is_err() {
            break;
        }
    }
    // What has ended on one side ends on the other.
    drop(to.shutdown(Shutdown::Both));
}
