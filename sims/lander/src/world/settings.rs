//! How a lander world can be set up.

use std::ops::RangeInclusive;

use leadtime_sims::check::{SettingError, require_within};
use serde::{Deserialize, Serialize};

/// Start forces that there can be, in newtons.
pub(crate) const START_IMPULSES: RangeInclusive<f64> = 0.0..=3000.0;

/// Which physics moves the lander.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Physics {
    /// The contact world near the ground, the exact free-flight integrator elsewhere: 1.4 to 2.8 times as fast.
    #[default]
    #[serde(rename = "two_gears")]
    Hybrid,
    /// The contact world in every frame.
    Rapier,
}

/// Settings of the lander world; the defaults are those of `LunarLander-v3`.
#[derive(Clone, Debug, PartialEq)]
pub struct PhysicsSettings {
    /// Which physics moves the lander.
    pub physics: Physics,
    /// Whether wind and turbulence act while no leg is on the ground.
    pub wind: bool,
    /// Largest wind force, in newtons, 0 to 20.
    pub wind_power: f64,
    /// Largest turbulence torque, in newton metres, 0 to 2.
    pub turbulence_power: f64,
    /// Largest horizontal and vertical start force, in newtons, 0 to 3000: larger throws the lander further off.
    pub start_impulse: f64,
}

impl Default for PhysicsSettings {
    fn default() -> Self {
        Self {
            physics: Physics::Hybrid,
            wind: false,
            wind_power: 15.0,
            turbulence_power: 1.5,
            start_impulse: 1000.0,
        }
    }
}

impl PhysicsSettings {
    /// Checks every range; the error names the first setting outside its own.
    pub(crate) fn check(&self) -> Result<(), SettingError> {
        require_within("world.wind_power", self.wind_power, 0.0..=20.0, "N")?;
        require_within("world.turbulence_power", self.turbulence_power, 0.0..=2.0, "N m")?;
        require_within("world.start_impulse", self.start_impulse, START_IMPULSES, "N")
    }
}
