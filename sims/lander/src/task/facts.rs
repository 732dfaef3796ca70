//! What is true of the flight now: the facts that sentences to the pilot presuppose.
//!
//! Distances are in the units of observed positions (10 m across, 6.67 m up): the pad is at height 0, the start at 1.4,
//! the flags at ±0.2. Speeds are those that are observed: 5 m/s across, 7.5 m/s up.
//!
//! | threshold | value | why |
//! |---|---|---|
//! | [`REACH`] | 0.5 | what the lander sinks, at the fastest descent it is asked for, while five words are heard and reacted to |
//! | [`NEAR`] | 0.25 | where the scripted notifier begins to warn by default; a good lander's width |
//! | [`JUST`] | 0.2 | as far as the pad is wide to one side: "just below" is nearer than that |
//! | [`HALF_WIDTH`] | 0.1 | half the lander's width, with its legs and a little air |

use leadtime_sims::Fact;

use super::zone::Zone;

/// How far below, above, ahead or to a side something may be to be spoken of.
const REACH: f64 = 0.5;
/// How far away a zone is near.
const NEAR: f64 = 0.25;
/// How far away a zone is just below or just above.
const JUST: f64 = 0.2;
/// Half of the width that the lander needs.
const HALF_WIDTH: f64 = 0.1;
/// Half of the pad's width.
const PAD: f64 = 0.2;
/// Slower than this it hovers: it moves nowhere that anybody would name.
const MOVES: f64 = 0.05;
/// Distances per second, across and up, at an observed speed of 1.
const PER_SECOND: [f64; 2] = [0.5, 1.125];
/// Places on the way ahead that are looked at.
const N_PLACES: u32 = 50;
/// Beside the pad and lower than this, the lander is too low to get there.
const LOW: f64 = 0.25;
/// Above the start, with room for the push that an episode begins with.
const HIGH: f64 = 1.5;
/// By how much a descent is faster than the one that a pilot is asked for to be called fast.
const FAST: f64 = 0.1;
/// What lies left of the middle and above this is at the top left.
const TOP: f64 = 0.8;

/// What the facts are read off.
#[derive(Clone, Copy, Debug)]
pub(super) struct FlightMoment<'a> {
    /// Where the lander is.
    pub(super) place: [f64; 2],
    /// Its speed, in observed units.
    pub(super) velocity: [f64; 2],
    /// The danger zones of the task.
    pub(super) zones: &'a [Zone],
}

impl FlightMoment<'_> {
    fn any(&self, holds: impl Fn(&Zone) -> bool) -> bool {
        self.zones.iter().any(holds)
    }

    /// Returns whether a zone overlaps the column of the lander's width.
    fn in_column(&self, zone: &Zone) -> bool {
        zone.x0 <= self.place[0] + HALF_WIDTH && self.place[0] - HALF_WIDTH <= zone.x1
    }

    fn is_below(&self, zone: &Zone, reach: f64) -> bool {
        let gap = self.place[1] - zone.y1;
        self.in_column(zone) && 0.0 < gap && gap <= reach
    }

    fn is_above(&self, zone: &Zone, reach: f64) -> bool {
        let gap = zone.y0 - self.place[1];
        self.in_column(zone) && 0.0 < gap && gap <= reach
    }

    /// Returns whether the lander, going on straight as it moves now, comes to a zone within [`REACH`].
    fn is_ahead(&self, zone: &Zone) -> bool {
        let [vx, vy] = self.way();
        let length = libm::sqrt(vx * vx + vy * vy);
        if length < MOVES || zone.contains(self.place) {
            return false;
        }
        let wide = Zone {
            x0: zone.x0 - HALF_WIDTH,
            x1: zone.x1 + HALF_WIDTH,
            y0: zone.y0 - HALF_WIDTH,
            y1: zone.y1 + HALF_WIDTH,
        };
        let [x, y] = self.place;
        let time = |i: u32| f64::from(i) / f64::from(N_PLACES) * REACH / length;
        (1..=N_PLACES).map(time).any(|t| wide.contains([x + vx * t, y + vy * t]))
            && self.approaches(zone)
    }

    /// Returns whether the lander comes nearer to a zone.
    fn approaches(&self, zone: &Zone) -> bool {
        let [x, y] = self.place;
        let nearest = [x.clamp(zone.x0, zone.x1) - x, y.clamp(zone.y0, zone.y1) - y];
        let [vx, vy] = self.way();
        nearest[0] * vx + nearest[1] * vy > 0.0
    }

    /// Returns how far it gets in a second.
    fn way(&self) -> [f64; 2] {
        [self.velocity[0] * PER_SECOND[0], self.velocity[1] * PER_SECOND[1]]
    }

    fn is_near(&self, zone: &Zone) -> bool {
        zone.distance(self.place) <= NEAR
    }

    /// Returns whether nothing is in the box next to the lander, on the side of the sign.
    fn is_free_beside(&self, sign: f64) -> bool {
        let ([x, y], to) = (self.place, self.place[0] + sign * REACH);
        let (x0, x1) = (x.min(to), x.max(to));
        !self.any(|zone| zone.x0 <= x1 && x0 <= zone.x1 && is_at_height(zone, y))
    }

    fn is_beside_pad(&self) -> bool {
        self.place[0].abs() > PAD
    }

    /// Returns whether the level path to the middle of the pad leads through a zone.
    fn level_way_is_barred(&self) -> bool {
        let [x, y] = self.place;
        self.any(|zone| {
            (zone.y0..=zone.y1).contains(&y) && zone.x0 <= x.max(0.0) && x.min(0.0) <= zone.x1
        })
    }

    /// Computes the fastest descent that a pilot is asked for at this height.
    fn asked_descent(&self) -> f64 {
        (0.1 + 0.6 * self.place[1].max(0.0)).min(0.6)
    }
}

/// Returns whether a zone overlaps the band of the lander's height.
fn is_at_height(zone: &Zone, y: f64) -> bool {
    zone.y0 <= y + HALF_WIDTH && y - HALF_WIDTH <= zone.y1
}

/// Returns whether a zone lies at the top left of the view.
fn is_top_left(zone: &Zone) -> bool {
    zone.x0 + zone.x1 < 0.0 && zone.y0 >= TOP
}

/// A fact, and whether it holds.
type FlightFact = (&'static str, &'static str, fn(&FlightMoment<'_>) -> bool);

/// Every fact of the domain.
const TOLD: &[FlightFact] = &[
    ("zone_near", "a zone is at most 0.25 away", |f| f.any(|zone| f.is_near(zone))),
    ("zone_below", "a zone lies under the lander, at most 0.5 below it", |f| {
        f.any(|zone| f.is_below(zone, REACH))
    }),
    ("zone_just_below", "a zone lies under the lander, at most 0.2 below it", |f| {
        f.any(|zone| f.is_below(zone, JUST))
    }),
    ("zone_above", "a zone lies over the lander, at most 0.5 above it", |f| {
        f.any(|zone| f.is_above(zone, REACH))
    }),
    ("zone_just_above", "a zone lies over the lander, at most 0.2 above it", |f| {
        f.any(|zone| f.is_above(zone, JUST))
    }),
    ("zone_ahead", "going on straight as it moves, the lander comes to a zone within 0.5", |f| {
        f.any(|zone| f.is_ahead(zone))
    }),
    ("zone_ahead_above", "the zone ahead lies higher than the lander", |f| {
        f.any(|zone| f.is_ahead(zone) && zone.y0 > f.place[1])
    }),
    ("top_left_zone_near", "a zone at the top left of the view is at most 0.25 away", |f| {
        f.any(|zone| is_top_left(zone) && f.is_near(zone))
    }),
    ("top_left_zone_ahead", "the zone ahead is at the top left of the view", |f| {
        f.any(|zone| is_top_left(zone) && f.is_ahead(zone))
    }),
    ("top_left_zone_above", "the zone over the lander is at the top left of the view", |f| {
        f.any(|zone| is_top_left(zone) && f.is_above(zone, REACH))
    }),
    (
        "too_low",
        "beside the pad and lower than 0.25, or so low that the level way to the pad leads through a zone",
        |f| f.is_beside_pad() && (f.place[1] < LOW || f.level_way_is_barred()),
    ),
    ("too_high", "higher than 1.5: above the start", |f| f.place[1] > HIGH),
    (
        "sinking_fast",
        "sinks faster, by 0.1, than a pilot is ever asked to at this height: min(0.6, 0.1 + 0.6 y)",
        |f| -f.velocity[1] > f.asked_descent() + FAST,
    ),
    ("off_course_left", "left of the pad, and moving further left", |f| {
        f.place[0] < -PAD && f.velocity[0] < -MOVES
    }),
    ("off_course_right", "right of the pad, and moving further right", |f| {
        f.place[0] > PAD && f.velocity[0] > MOVES
    }),
    ("moving_left", "moves to the left", |f| f.velocity[0] < -MOVES),
    ("moving_right", "moves to the right", |f| f.velocity[0] > MOVES),
    ("right_clear", "no zone within 0.5 to the right at this height", |f| f.is_free_beside(1.0)),
    ("down_clear", "no zone under the lander, down to the ground", |f| {
        !f.any(|zone| f.is_below(zone, f64::INFINITY) || zone.contains(f.place))
    }),
    ("pad_clear", "no zone over the pad that is not above the lander", |f| {
        !f.any(|zone| zone.x0 <= PAD && -PAD <= zone.x1 && zone.y0 <= f.place[1])
    }),
];

pub(super) fn facts() -> Vec<Fact> {
    TOLD.iter().map(|&(name, meaning, _)| Fact { name, meaning }).collect()
}

/// Says which of them hold. Shape as [`facts`].
pub(super) fn observe(flight: &FlightMoment<'_>, holds: &mut [bool]) {
    for ((.., is_so), out) in TOLD.iter().zip(holds) {
        *out = is_so(flight);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::DEFAULT_ZONES;

    const STILL: [f64; 2] = [0.0, 0.0];

    /// Where the lander is and how it moves.
    type PlaceAndSpeed = ([f64; 2], [f64; 2]);

    fn holds(name: &str, place: [f64; 2], velocity: [f64; 2]) -> bool {
        let flight = FlightMoment { place, velocity, zones: &DEFAULT_ZONES };
        let told = TOLD.iter().find(|told| told.0 == name).unwrap_or_else(|| panic!("{name}"));
        (told.2)(&flight)
    }

    /// Of every fact, a moment in which it holds and the like of it in which it does not.
    const MOMENTS: &[(&str, PlaceAndSpeed, PlaceAndSpeed)] = &[
        ("zone_near", ([0.0, 0.85], STILL), ([0.0, 0.95], STILL)),
        ("zone_below", ([0.0, 0.9], STILL), ([0.0, 0.45], STILL)),
        ("zone_below", ([-0.35, 0.9], STILL), ([-0.45, 0.9], STILL)),
        ("zone_just_below", ([0.0, 0.8], STILL), ([0.0, 0.9], STILL)),
        ("zone_above", ([0.0, 0.2], STILL), ([0.0, 0.7], STILL)),
        ("zone_just_above", ([0.0, 0.4], STILL), ([0.0, 0.2], STILL)),
        ("zone_ahead", ([0.0, 0.9], [0.0, -0.3]), ([0.0, 0.9], [0.0, 0.3])),
        ("zone_ahead", ([-0.6, 0.6], [0.3, 0.0]), ([-0.6, 0.6], STILL)),
        ("zone_ahead_above", ([0.0, 0.3], [0.0, 0.3]), ([0.0, 0.9], [0.0, -0.3])),
        ("top_left_zone_near", ([-0.3, 1.0], STILL), ([0.0, 0.7], STILL)),
        ("top_left_zone_ahead", ([-0.2, 1.0], [-0.3, 0.0]), ([-0.6, 0.6], [0.3, 0.0])),
        ("top_left_zone_above", ([-0.6, 0.7], STILL), ([0.0, 0.3], STILL)),
        ("too_low", ([0.5, 0.2], STILL), ([0.1, 0.2], STILL)),
        ("too_low", ([0.8, 0.6], STILL), ([0.8, 0.7], STILL)),
        ("too_high", ([0.0, 1.6], STILL), ([0.0, 1.41], STILL)),
        ("sinking_fast", ([0.0, 0.2], [0.0, -0.4]), ([0.0, 1.2], [0.0, -0.6])),
        ("off_course_left", ([-0.5, 0.7], [-0.2, 0.0]), ([-0.5, 0.7], [0.2, 0.0])),
        ("off_course_right", ([0.5, 0.8], [0.2, 0.0]), ([-0.5, 0.8], [0.2, 0.0])),
        ("moving_left", ([0.0, 1.0], [-0.1, 0.0]), ([0.0, 1.0], [0.1, 0.0])),
        ("moving_right", ([0.0, 1.0], [0.1, 0.0]), ([0.0, 1.0], [-0.1, 0.0])),
        ("right_clear", ([0.0, 1.0], STILL), ([-0.5, 0.6], STILL)),
        ("down_clear", ([-0.5, 0.8], STILL), ([0.0, 0.8], STILL)),
        ("pad_clear", ([0.0, 0.45], STILL), ([0.0, 0.7], STILL)),
    ];

    #[test]
    fn every_fact_holds_where_a_pilot_would_agree_and_nowhere_else() {
        for &(name, (place, velocity), (elsewhere, other)) in MOMENTS {
            assert!(holds(name, place, velocity), "{name} at {place:?}");
            assert!(!holds(name, elsewhere, other), "{name} at {elsewhere:?}");
        }
        let tried = |told: &FlightFact| MOMENTS.iter().any(|moment| moment.0 == told.0);
        assert!(TOLD.iter().all(tried));
    }

    #[test]
    fn without_zones_no_zone_is_anywhere() {
        let flight = FlightMoment { place: [0.0, 0.9], velocity: [0.3, -0.3], zones: &[] };
        let about_zones = |told: &&FlightFact| told.0.contains("zone");
        assert!(!TOLD.iter().filter(about_zones).any(|told| (told.2)(&flight)));
    }
}
