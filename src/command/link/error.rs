//! Reasons why a machine cannot take part in a fleet on several machines.

/// Reason why a machine cannot take part in a fleet on several machines.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkArgsError {
    /// The binary has no Zenoh.
    #[error(
        "this mr-slam was built without the link between machines; build one that has it with `cargo build --release \
         --features link`"
    )]
    NotBuilt,
    /// The option of `up` has no meaning: it is for several robots.
    #[error("{0} has no meaning here: `--name` names the robot of this machine, and there is one")]
    RobotOption(&'static str),
    /// The base has no world of its own.
    #[error(
        "--world has no meaning here: the base's robots are on other machines; give it to `mr-slam robot`"
    )]
    BaseWorld,
    /// Zenoh failed while it opened the session.
    #[error("the link's session panicked while it was opened; it is started again")]
    Panic,
    /// Robots either join at the base or at a router.
    #[error("--listen and --router exclude each other: the base listens for robots, or a router does")]
    ListenAndRouter,
    /// The base and a router must know their robots.
    #[error("which robots may join? Give --names, such as --names alice,bob, or `names` in the fleet file")]
    NoNames,
}
