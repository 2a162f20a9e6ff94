//! Values that a command carries: what each may be, to and from the plain numbers of the wire and the words of the ground.

/// What kind of value a parameter has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    /// 0 or 1; in words also `false` and `true`, `off` and `on`.
    Flag,
    /// A whole number.
    Integer,
    /// A number.
    Real,
    /// A word out of a list; as a number its place, from 0.
    Choice(&'static [&'static str]),
}

/// A type that may stand in a command. On the wire every value is an `f64`, which holds each of them exactly.
pub trait Value: Copy + PartialEq + std::fmt::Debug {
    /// Its kind.
    const SHAPE: Shape;
    /// From a number that its parameter has let through.
    fn of(number: f64) -> Self;
    /// As a number.
    fn number(self) -> f64;
}

impl Value for bool {
    const SHAPE: Shape = Shape::Flag;
    fn of(number: f64) -> Self {
        number == 1.0
    }
    fn number(self) -> f64 {
        f64::from(u8::from(self))
    }
}

impl Value for i32 {
    const SHAPE: Shape = Shape::Integer;
    fn of(number: f64) -> Self {
        number as Self
    }
    fn number(self) -> f64 {
        f64::from(self)
    }
}

impl Value for u32 {
    const SHAPE: Shape = Shape::Integer;
    fn of(number: f64) -> Self {
        number as Self
    }
    fn number(self) -> f64 {
        f64::from(self)
    }
}

impl Value for f64 {
    const SHAPE: Shape = Shape::Real;
    fn of(number: f64) -> Self {
        number
    }
    fn number(self) -> f64 {
        self
    }
}

/// When the display shows the autofocus instead of the image's figures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "the names are the meaning")]
pub enum ShowFocus {
    Auto,
    On,
    Off,
}

impl Value for ShowFocus {
    const SHAPE: Shape = Shape::Choice(&["auto", "on", "off"]);
    fn of(number: f64) -> Self {
        match number as u8 {
            0 => Self::Auto,
            1 => Self::On,
            _ => Self::Off,
        }
    }
    fn number(self) -> f64 {
        f64::from(self as u8)
    }
}

/// One parameter of a command.
#[derive(Debug, Clone, PartialEq)]
pub struct Parameter {
    /// Its name, with the unit in it.
    pub name: &'static str,
    /// What kind of value.
    pub shape: Shape,
    /// Unit, empty where it has none.
    pub unit: &'static str,
    /// Least value.
    pub low: f64,
    /// Greatest value.
    pub high: f64,
    /// What it means.
    pub meaning: &'static str,
}

impl Parameter {
    /// Whether a number is one of this parameter's values: finite, in range, and whole where it must be.
    pub fn allows(&self, number: f64) -> bool {
        let whole = self.shape == Shape::Real || number.fract() == 0.0;
        number.is_finite() && whole && (self.low..=self.high).contains(&number)
    }

    /// What is allowed, in words.
    pub fn expected(&self) -> String {
        match self.shape {
            Shape::Flag => "0 or 1".to_owned(),
            Shape::Choice(words) => words.join(", "),
            Shape::Integer => format!("a whole number from {} to {}", self.low, self.high),
            Shape::Real => format!("a number from {} to {}", self.low, self.high),
        }
    }

    /// The number that a word stands for; `None` for what is no value of this shape, whatever the range.
    pub fn read(&self, word: &str) -> Option<f64> {
        match self.shape {
            Shape::Flag => match word {
                "0" | "false" | "off" => Some(0.0),
                "1" | "true" | "on" => Some(1.0),
                _ => None,
            },
            Shape::Choice(words) => words.iter().position(|known| *known == word).map(|place| place as f64),
            Shape::Integer | Shape::Real => word.parse().ok().filter(|number: &f64| number.is_finite()),
        }
    }

    /// A number as the word that stands for it.
    pub fn word(&self, number: f64) -> String {
        match self.shape {
            Shape::Choice(words) => words.get(number as usize).map_or_else(|| number.to_string(), |word| (*word).to_owned()),
            _ => number.to_string(),
        }
    }
}
