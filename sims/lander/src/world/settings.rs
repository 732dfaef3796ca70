//! How a lander world can be set up.

use leadtime_sims::check::{SettingError, require};
use serde::{Deserialize, Serialize};

/// Which physics moves the lander.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Physics {
    /// The contact world near the ground, the exact free-flight integrator elsewhere: about four times as fast.
    #[default]
    #[serde(rename = "two_gears")]
    Hybrid,
    /// The contact world in every frame.
    Rapier,
}

/// Settings of the lander world; the defaults are those of `LunarLander-v3`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
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
    /// Whether engines push in slightly random directions.
    pub dispersion: bool,
}

impl Default for PhysicsSettings {
    fn default() -> Self {
        Self {
            physics: Physics::Hybrid,
            wind: false,
            wind_power: 15.0,
            turbulence_power: 1.5,
            start_impulse: 1000.0,
            dispersion: true,
        }
    }
}

impl PhysicsSettings {
    /// Checks every range.
    ///
    /// # Errors
    ///
    /// [`SettingError`] naming the first setting outside its range.
    pub fn check(&self) -> Result<(), SettingError> {
        check_powers(self.wind_power, self.turbulence_power)?;
        check_impulse("world.start_impulse", self.start_impulse)
    }
}

/// Checks the strength of the weather; a NaN is in no range.
pub(crate) fn check_powers(wind: f64, turbulence: f64) -> Result<(), SettingError> {
    require((0.0..=20.0).contains(&wind), "world.wind_power", wind, "0 to 20 N")?;
    let mild = (0.0..=2.0).contains(&turbulence);
    require(mild, "world.turbulence_power", turbulence, "0 to 2 N m")
}

/// Checks a start force.
pub(crate) fn check_impulse(key: &'static str, newtons: f64) -> Result<(), SettingError> {
    require((0.0..=3000.0).contains(&newtons), key, newtons, "0 to 3000 N")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_outside_their_range_are_named() {
        PhysicsSettings::default().check().unwrap();
        let error = PhysicsSettings { wind_power: f64::NAN, ..PhysicsSettings::default() }.check();
        assert_eq!(error.unwrap_err().key, "world.wind_power");
        let error = PhysicsSettings { start_impulse: -1.0, ..PhysicsSettings::default() }.check();
        let text = error.unwrap_err().to_string();
        assert_eq!(text, "`world.start_impulse` is -1; allowed: 0 to 3000 N");
    }

    #[test]
    fn an_unknown_key_is_refused() {
        let error = serde_json::from_str::<PhysicsSettings>(r#"{"wnd": true}"#).unwrap_err();
        assert!(error.to_string().contains("unknown field `wnd`"), "{error}");
    }
}
