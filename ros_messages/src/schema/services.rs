//! ROS 2 definitions of the services that the bridge offers to clients which learn types from schemas.
//!
//! Fields of std_srvs and of slam_toolbox 2.8 (Jazzy).

use super::with_used_types;

/// A service's type with the fields of its request and its response, one a line.
struct ServiceDefinition {
    name: &'static str,
    request: &'static str,
    response: &'static str,
    /// Types that the request uses.
    uses: &'static [&'static str],
}

const fn service(name: &'static str, request: &'static str, response: &'static str) -> ServiceDefinition {
    ServiceDefinition { name, request, response, uses: &[] }
}

/// The response of std_srvs/SetBool and std_srvs/Trigger.
const DONE_WITH_TEXT: &str = "bool success\nstring message";
/// The response of slam_toolbox's services that write files or reset.
const RESULT: &str = "uint8 RESULT_SUCCESS=0\nuint8 RESULT_FAILURE=255\nuint8 result";

const SERVICES: &[ServiceDefinition] = &[
    ServiceDefinition {
        uses: &["geometry_msgs/Pose2D"],
        ..service(
            "slam_toolbox/DeserializePoseGraph",
            "int8 UNSET=0\nint8 START_AT_FIRST_NODE=1\nint8 START_AT_GIVEN_POSE=2\nint8 LOCALIZE_AT_POSE=3\n\
             string filename\nint8 match_type\ngeometry_msgs/Pose2D initial_pose",
            "",
        )
    },
    service("slam_toolbox/Pause", "", "bool status"),
    service("slam_toolbox/Reset", "bool pause_new_measurements", RESULT),
    ServiceDefinition {
        uses: &["std_msgs/String"],
        ..service("slam_toolbox/SaveMap", "std_msgs/String name", RESULT)
    },
    service("slam_toolbox/SerializePoseGraph", "string filename", RESULT),
    service("std_srvs/Empty", "", ""),
    service("std_srvs/SetBool", "bool data", DONE_WITH_TEXT),
    service("std_srvs/Trigger", "", DONE_WITH_TEXT),
];

/// Schemas of a service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServiceSchemas {
    /// Schema of the request.
    pub request: String,
    /// Schema of the response.
    pub response: String,
}

/// Returns the schemas of a service type, `package/Type`; `None` if it is not known.
pub fn service_schemas(service_type: &str) -> Option<ServiceSchemas> {
    let definition = SERVICES.iter().find(|definition| definition.name == service_type)?;
    let request = with_used_types(definition.request, definition.uses);
    Some(ServiceSchemas { request, response: with_used_types(definition.response, &[]) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_service_has_the_fields_of_its_request_and_the_types_that_they_use() {
        let trigger = service_schemas("std_srvs/Trigger").unwrap();
        assert_eq!(trigger, ServiceSchemas { request: "\n".into(), response: format!("{DONE_WITH_TEXT}\n") });
        let save = service_schemas("slam_toolbox/SaveMap").unwrap();
        assert!(save.request.contains("MSG: std_msgs/String\nstring data\n"), "{}", save.request);
        assert_eq!(service_schemas("nav_msgs/GetPlan"), None);
    }
}
