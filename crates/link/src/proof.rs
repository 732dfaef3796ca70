//! Proving which start of which process a message comes from, without certificates.
//!
//! Every start of a learner or an actor draws a pair of keys, and its number ([`Incarnation`]) is the digest of the public one. So
//! who can prove that a message was made with the secret one has proved the number in its header, whatever network the
//! message crossed and whoever else listens there.
//!
//! ```text
//! for one    body ‖ public key of the sender (32) ‖ tag (32)         a keyed hash; the key is what Diffie-Hellman gives both
//! for all    body ‖ public key of the sender (32) ‖ signature (64)   hello, announcements
//! ```
//!
//! It stands behind the body, so that a process of another release can still read the header in front, and say that the
//! releases differ.
//!
//! A proof can be copied with its message. So hellos are numbered and count once, and an answer carries the number of its question;
//! everything else is a count that only rises.
//!
//! What it does not do: it says that two messages come from the same start, not who that is. Anybody may draw keys, say
//! hello as an actor of their own, or offer a run of their own; and what is sent can be read. That is what certificates
//! and access lists are for.
//!
//! # Source
//!
//! Ed25519: RFC 8032; X25519: RFC 7748; the keyed hash: BLAKE3, section 2.3 of its specification.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::{Arc, Mutex};

use ed25519_dalek::{Signature, Signer as _, SigningKey, VerifyingKey};
use leadtime_proto::{Header, Incarnation, Refusal, RefusalCause};

use crate::lock::lock;
use crate::{Error, Result};

/// Bytes of a public key.
const KEY_BYTES: usize = 32;
/// Bytes that stand behind a message for one.
pub(crate) const TAG_PROOF_BYTES: usize = KEY_BYTES + blake3::OUT_LEN;
/// Bytes that stand behind a message for all.
pub(crate) const SIGNED_PROOF_BYTES: usize = KEY_BYTES + Signature::BYTE_SIZE;
/// What the key of two starts is derived for, and nothing else.
const PURPOSE: &str = "leadtime 2026-12-01 messages between a learner and an actor";
/// The most starts whose keys are kept; those of others are computed again, which takes some 50 microseconds. Those that are in use, as
/// the keys of a learner's members are, stay: with them their counts of hellos would be forgotten, and copies of old ones count.
const MAX_PEERS: usize = 4_096;

/// The keys of one start of a process. Its number distinguishes this start from every other, and is proved with them.
#[derive(Clone)]
pub struct StartKey(Arc<SigningKey>);

impl StartKey {
    /// Draws the keys of this start.
    ///
    /// # Errors
    ///
    /// [`Error::Random`] if the operating system has no random bytes.
    pub fn draw() -> Result<Self> {
        let mut seed = [0; KEY_BYTES];
        getrandom::fill(&mut seed).map_err(Error::Random)?;
        Ok(Self(Arc::new(SigningKey::from_bytes(&seed))))
    }

    /// Makes the keys that belong to a number, for tests: whoever knows the number has them.
    #[cfg(any(test, feature = "fakes"))]
    pub fn numbered(number: u64) -> Self {
        let mut seed = [0; KEY_BYTES];
        seed[..8].copy_from_slice(&number.to_le_bytes());
        Self(Arc::new(SigningKey::from_bytes(&seed)))
    }

    /// Returns the number of the start.
    pub fn incarnation(&self) -> Incarnation {
        number(self.0.verifying_key().as_bytes())
    }

    /// Proves a message to everybody.
    pub(crate) fn sign(&self, header: &Header, body: &[u8]) -> [u8; SIGNED_PROOF_BYTES] {
        let signature = self.0.sign(digest(blake3::Hasher::new(), header, body).as_bytes());
        let mut proof = [0; SIGNED_PROOF_BYTES];
        proof[..KEY_BYTES].copy_from_slice(self.0.verifying_key().as_bytes());
        proof[KEY_BYTES..].copy_from_slice(&signature.to_bytes());
        proof
    }
}

impl fmt::Debug for StartKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("StartKey").field(&self.incarnation()).finish()
    }
}

/// What two starts share: each proves its messages to the other with it.
pub(crate) struct PeerKey {
    own: [u8; KEY_BYTES],
    shared: [u8; blake3::KEY_LEN],
    /// The number of our own start.
    pub(crate) us: Incarnation,
    /// The number of the other one.
    pub(crate) peer: Incarnation,
}

impl PeerKey {
    fn new(own: &StartKey, peer: &VerifyingKey) -> Self {
        let (own, ours) = (own.0.verifying_key().to_bytes(), &own.0);
        // One pair of keys serves for both: an Ed25519 key is an X25519 key in other coordinates (RFC 7748, section 4.1).
        let secret = peer.to_montgomery().mul_clamped(ours.to_scalar_bytes());
        // Both sides have to hash the two public keys in the same order.
        let theirs = peer.to_bytes();
        let mut material = blake3::Hasher::new_derive_key(PURPOSE);
        material.update(secret.as_bytes()).update(own.min(theirs).as_slice());
        material.update(own.max(theirs).as_slice());
        let shared = material.finalize().into();
        Self { own, shared, us: number(&own), peer: number(&theirs) }
    }

    /// Proves a message to the other start.
    pub(crate) fn prove(&self, header: &Header, body: &[u8]) -> [u8; TAG_PROOF_BYTES] {
        let mut proof = [0; TAG_PROOF_BYTES];
        proof[..KEY_BYTES].copy_from_slice(&self.own);
        proof[KEY_BYTES..].copy_from_slice(self.tag(header, body).as_bytes());
        proof
    }

    /// Splits the proof off a message, and checks that the other start made it for us. It costs a hash, whoever sent it.
    ///
    /// # Errors
    ///
    /// As [`Keyring::check`].
    pub(crate) fn check<'a>(
        &self,
        header: &Header,
        message: &'a [u8],
    ) -> Result<&'a [u8], Refusal> {
        let MessageParts { body, made, .. } = MessageParts::split(header, message)?;
        let is_theirs = header.incarnation == self.peer && self.tag(header, body) == *made;
        if is_theirs { Ok(body) } else { Err(refused()) }
    }

    /// Makes what two starts share of both, for tests.
    #[cfg(test)]
    pub(crate) fn shared(own: &StartKey, peer: &StartKey) -> Self {
        Self::new(own, &peer.0.verifying_key())
    }

    fn tag(&self, header: &Header, body: &[u8]) -> blake3::Hash {
        digest(blake3::Hasher::new_keyed(&self.shared), header, body)
    }
}

impl fmt::Debug for PeerKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PeerKey")
            .field("us", &self.us)
            .field("peer", &self.peer)
            .finish_non_exhaustive()
    }
}

/// The keys of our own start, and those that it shares with others, by their numbers.
#[derive(Debug)]
pub(crate) struct Keyring {
    pub(crate) own: StartKey,
    peers: Mutex<Peers>,
}

#[derive(Debug, Default)]
struct Peers {
    /// Counts uses: the entry with the lowest number was used least recently.
    clock: u64,
    known: BTreeMap<Incarnation, Known>,
}

#[derive(Debug)]
struct Known {
    key: Arc<PeerKey>,
    used: u64,
    /// The number of its last hello.
    n_hellos: u64,
}

impl Known {
    /// Orders the starts by who is forgotten first: those whose key nobody holds, the one that was used least recently.
    fn age(&self) -> (bool, u64) {
        (Arc::strong_count(&self.key) > 1, self.used)
    }
}

impl Keyring {
    pub(crate) fn new(own: StartKey) -> Self {
        Self { own, peers: Mutex::default() }
    }

    /// Returns the key shared with a start that has proved a message here.
    fn of(&self, peer: Incarnation) -> Option<Arc<PeerKey>> {
        lock(&self.peers).touch(peer).map(|known| Arc::clone(&known.key))
    }

    /// Splits the proof for one off a message, and checks that the start in its header made it.
    ///
    /// # Errors
    ///
    /// [`RefusalCause::Proof`], without a sender: it is not known who sent it.
    pub(crate) fn check<'a>(
        &self,
        header: &Header,
        message: &'a [u8],
    ) -> Result<(Arc<PeerKey>, &'a [u8]), Refusal> {
        let MessageParts { body, public, made } = MessageParts::split(header, message)?;
        let known = self.of(header.incarnation);
        let key = match &known {
            Some(key) => Arc::clone(key),
            None => Arc::new(PeerKey::new(&self.own, &readable(public)?)),
        };
        // The comparison of two hashes takes the same time wherever they differ.
        if key.tag(header, body) != *made {
            return Err(refused());
        }
        // Only now: a peer that proves nothing takes nobody's place.
        if known.is_none() {
            lock(&self.peers).keep(Arc::clone(&key));
        }
        Ok((key, body))
    }

    /// Does the same for a hello, which is signed: its sender does not know our key yet. One that is not newer than the
    /// last is somebody's copy.
    ///
    /// # Errors
    ///
    /// As [`Keyring::check`].
    pub(crate) fn check_hello<'a>(
        &self,
        header: &Header,
        message: &'a [u8],
    ) -> Result<(Arc<PeerKey>, &'a [u8]), Refusal> {
        let (public, body) = check_signed(header, message)?;
        // The signature was checked first: a stranger must not use up the numbers of somebody's hellos.
        let key = self.meet(&public);
        let mut peers = lock(&self.peers);
        let known =
            peers.touch(header.incarnation).filter(|known| known.n_hellos < header.sequence.0);
        known.ok_or_else(refused)?.n_hellos = header.sequence.0;
        Ok((key, body))
    }

    /// Computes and keeps the key shared with a start.
    fn meet(&self, peer: &VerifyingKey) -> Arc<PeerKey> {
        if let Some(key) = self.of(number(peer.as_bytes())) {
            return key;
        }
        let key = Arc::new(PeerKey::new(&self.own, peer));
        lock(&self.peers).keep(Arc::clone(&key));
        key
    }
}

impl Peers {
    fn touch(&mut self, peer: Incarnation) -> Option<&mut Known> {
        self.clock += 1;
        let known = self.known.get_mut(&peer)?;
        known.used = self.clock;
        Some(known)
    }

    fn keep(&mut self, key: Arc<PeerKey>) {
        if self.known.len() >= MAX_PEERS
            && let Some((&oldest, _)) = self.known.iter().min_by_key(|(_, known)| known.age())
        {
            self.known.remove(&oldest);
        }
        self.clock += 1;
        let used = self.clock;
        // A key that is there already is the same one, and its count of hellos must not begin again.
        self.known.entry(key.peer).or_insert(Known { key, used, n_hellos: 0 });
    }
}

/// Splits the proof for all off a message, and checks that the start in its header made it.
///
/// # Errors
///
/// As [`Keyring::check`].
pub(crate) fn check_signed<'a>(
    header: &Header,
    message: &'a [u8],
) -> Result<(VerifyingKey, &'a [u8]), Refusal> {
    let MessageParts { body, public, made } = MessageParts::split(header, message)?;
    let public = readable(public)?;
    let signed = digest(blake3::Hasher::new(), header, body);
    // Strictly: no part may be of small order, with which one signature could fit several messages.
    let checked = public.verify_strict(signed.as_bytes(), &Signature::from_bytes(made));
    checked.map_err(|_forged| refused())?;
    Ok((public, body))
}

/// A message in its parts.
struct MessageParts<'a, const N: usize> {
    body: &'a [u8],
    /// The public key of its sender, whose digest is the number in the header.
    public: &'a [u8; KEY_BYTES],
    /// What its sender made with the secret one.
    made: &'a [u8; N],
}

impl<'a, const N: usize> MessageParts<'a, N> {
    fn split(header: &Header, message: &'a [u8]) -> Result<Self, Refusal> {
        let parts = message.split_last_chunk::<N>().and_then(|(rest, made)| {
            let (body, public) = rest.split_last_chunk::<KEY_BYTES>()?;
            Some(Self { body, public, made })
        });
        // A proof by another key than the one that the header's number stands for says nothing of that number.
        parts.filter(|parts| number(parts.public) == header.incarnation).ok_or_else(refused)
    }
}

/// Reads a public key; with a weak one anybody could make proofs.
fn readable(public: &[u8; KEY_BYTES]) -> Result<VerifyingKey, Refusal> {
    VerifyingKey::from_bytes(public).ok().filter(|key| !key.is_weak()).ok_or_else(refused)
}

/// Returns the number of the start that has this public key.
fn number(public: &[u8; KEY_BYTES]) -> Incarnation {
    let digest = blake3::hash(public);
    let mut bytes = [0; 8];
    bytes.copy_from_slice(&digest.as_bytes()[..8]);
    Incarnation(u64::from_le_bytes(bytes))
}

fn digest(mut hasher: blake3::Hasher, header: &Header, body: &[u8]) -> blake3::Hash {
    // The header has a fixed length: no two pairs of header and body are the same bytes.
    hasher.update(&header.to_bytes()).update(body).finalize()
}

/// Nobody is blamed: anybody can put any number in a header.
pub(crate) fn refused() -> Refusal {
    let text = "the message does not prove that it comes from the process that its header names";
    Refusal::new(RefusalCause::Proof, text)
}

#[cfg(test)]
mod tests {
    use leadtime_proto::header::Schema;
    use leadtime_proto::{PolicyVersion, Sequence};

    use super::*;

    fn keyring(number: u64) -> Keyring {
        Keyring::new(StartKey::numbered(number))
    }

    /// A message for one, from the first to the second.
    fn message(from: &Keyring, to: &Keyring, body: &[u8]) -> (Header, Vec<u8>) {
        let key = PeerKey::shared(&from.own, &to.own);
        let header = Header::plain(Schema::Rollout, from.own.incarnation(), body);
        (header, [body, &key.prove(&header, body)].concat())
    }

    fn cause<T>(checked: Result<T, Refusal>) -> (RefusalCause, Option<Incarnation>) {
        let refusal = checked.map(drop).unwrap_err();
        (refusal.cause, refusal.sender)
    }

    const NO: (RefusalCause, Option<Incarnation>) = (RefusalCause::Proof, None);

    #[test]
    fn two_starts_prove_their_messages_to_each_other() {
        let (actor, learner) = (keyring(1), keyring(2));
        let (header, sent) = message(&actor, &learner, b"rollout");
        let (key, body) = learner.check(&header, &sent).unwrap();
        assert_eq!(
            (body, key.peer, key.us),
            (&b"rollout"[..], actor.own.incarnation(), learner.own.incarnation())
        );
        let back = Header::plain(Schema::Credit, key.us, b"credit");
        let sent = [&b"credit"[..], &key.prove(&back, b"credit")].concat();
        assert_eq!(actor.check(&back, &sent).unwrap().1, b"credit");
    }

    #[test]
    fn no_byte_of_header_body_or_proof_can_be_changed() {
        let (actor, learner) = (keyring(1), keyring(2));
        let (header, sent) = message(&actor, &learner, b"rollout");
        for at in 0..sent.len() {
            let mut changed = sent.clone();
            changed[at] ^= 1;
            assert_eq!(cause(learner.check(&header, &changed)), NO, "{at}");
        }
        let changed = [
            Header { sequence: Sequence(1), ..header },
            Header { version: PolicyVersion(1), ..header },
            Header { schema: Schema::Credit, ..header },
            Header { incarnation: Incarnation(7), ..header },
        ];
        for header in changed {
            assert_eq!(cause(learner.check(&header, &sent)), NO, "{header:?}");
        }
        for n in 0..sent.len() {
            assert_eq!(cause(learner.check(&header, &sent[..n])), NO, "{n}");
        }
        assert!(learner.check(&header, &sent).is_ok());
    }

    #[test]
    fn a_message_for_one_start_proves_nothing_to_another_or_to_its_sender() {
        let (actor, learner, stranger) = (keyring(1), keyring(2), keyring(3));
        let (header, sent) = message(&actor, &learner, b"rollout");
        assert_eq!(cause(stranger.check(&header, &sent)), NO);
        // Its own message under the number of another.
        let (_, own) = message(&stranger, &learner, b"rollout");
        assert_eq!(cause(learner.check(&header, &own)), NO);
        // Back to its sender.
        assert_eq!(cause(actor.check(&header, &sent)), NO);
        let known = PeerKey::shared(&learner.own, &actor.own);
        assert_eq!(known.check(&header, &sent).unwrap(), b"rollout");
        let (header, sent) = message(&stranger, &learner, b"rollout");
        assert_eq!(cause(known.check(&header, &sent)), NO, "it is another's");
    }

    #[test]
    fn a_sender_that_proves_nothing_takes_no_place_among_the_keys() {
        let (learner, stranger) = (keyring(1), keyring(2));
        let (header, mut sent) = message(&stranger, &learner, b"rollout");
        sent[0] ^= 1;
        assert_eq!(cause(learner.check(&header, &sent)), NO);
        assert!(lock(&learner.peers).known.is_empty());
    }

    fn hello(actor: &StartKey, number: u64) -> (Header, Vec<u8>) {
        let plain = Header::plain(Schema::Hello, actor.incarnation(), b"hello");
        let header = Header { sequence: Sequence(number), ..plain };
        (header, [&b"hello"[..], &actor.sign(&header, b"hello")].concat())
    }

    #[test]
    fn an_old_hello_of_a_start_that_is_here_is_refused_however_many_others_come() {
        let (actor, learner) = (StartKey::numbered(1), keyring(2));
        let (header, sent) = hello(&actor, 1);
        let (held, _) = learner.check_hello(&header, &sent).unwrap();
        let others = |learner: &Keyring| {
            let (own, shared) = ([0; KEY_BYTES], [0; blake3::KEY_LEN]);
            let us = learner.own.incarnation();
            for n in 0..2 * MAX_PEERS as u64 {
                let key = PeerKey { own, shared, us, peer: Incarnation(n) };
                lock(&learner.peers).keep(Arc::new(key));
            }
            assert_eq!(lock(&learner.peers).known.len(), MAX_PEERS);
        };
        others(&learner);
        assert_eq!(cause(learner.check_hello(&header, &sent)), NO);
        drop(held);
        others(&learner);
        assert!(learner.of(actor.incarnation()).is_none(), "it is gone, and takes no room");
    }

    #[test]
    fn a_hello_counts_once() {
        let (actor, learner) = (StartKey::numbered(1), keyring(2));
        let hello = |number| hello(&actor, number);
        let check =
            |(header, sent): (Header, Vec<u8>)| learner.check_hello(&header, &sent).map(drop);
        assert!(check(hello(1)).is_ok());
        assert_eq!(cause(check(hello(1))), NO);
        assert!(check(hello(3)).is_ok());
        assert_eq!(cause(check(hello(2))), NO);
        let (header, mut forged) = hello(4);
        forged[0] ^= 1;
        assert_eq!(cause(check((header, forged))), NO);
        assert!(check(hello(4)).is_ok(), "a forged one takes no number");
        assert!(learner.of(actor.incarnation()).is_some());
    }

    #[test]
    fn no_more_keys_are_kept_than_there_is_room_for_and_the_busy_ones_stay() {
        let (learner, busy) = (keyring(0), keyring(1));
        let (header, sent) = message(&busy, &learner, b"rollout");
        let shared = learner.check(&header, &sent).unwrap().0.shared;
        let mut peers = lock(&learner.peers);
        for n in 0..2 * MAX_PEERS as u64 {
            peers.touch(busy.own.incarnation());
            let us = learner.own.incarnation();
            peers.keep(Arc::new(PeerKey { own: [0; KEY_BYTES], shared, us, peer: Incarnation(n) }));
        }
        assert_eq!(peers.known.len(), MAX_PEERS);
        assert!(peers.known.contains_key(&busy.own.incarnation()));
    }

    #[test]
    fn a_key_with_which_anybody_could_prove_anything_is_refused() {
        // The neutral element: every signature of order 1 fits, and the shared secret is zero.
        let mut weak = [0; KEY_BYTES];
        weak[0] = 1;
        assert!(readable(&weak).is_err());
    }
}
