//! Commands of people and programs as JSON, each with who sent it, for recordings.

use msg::{
    EdgeAction, EdgeCommand, NavigationCommand, NavigationFrame, OperatorAction, OperatorEvent, ROBOTS_MAX,
    RobotId, SlamMode, SlamRequest, SlamRequestKind,
};
use serde_json::{Value, json};

/// Returns a command to navigation as JSON: action, frame, poses x m, y m, yaw rad (`null`: any heading).
pub fn navigation_command_json(command: &NavigationCommand) -> serde_json::Value {
    let poses = command.poses().iter().map(|pose| {
        let yaw_rad = Some(pose.yaw_rad).filter(|yaw| yaw.is_finite());
        json!([pose.x_m, pose.y_m, yaw_rad])
    });
    let frame = command.frame().map(|frame| match frame {
        NavigationFrame::MergedMap => "map",
        NavigationFrame::RobotMap => "robot_map",
        NavigationFrame::Odom => "odom",
        NavigationFrame::Base => "base_footprint",
    });
    json!({
        "sender": command.sender.to_string(),
        "number": command.number,
        "action": command.action().map(|action| format!("{action:?}").to_lowercase()),
        "frame": frame,
        "frame_robot": command.frame_robot().map(|robot| robot.to_string()),
        "poses": poses.collect::<Vec<_>>(),
    })
}

/// Returns a request to SLAM as JSON: its kind, and those of its values that the kind uses.
pub fn slam_request_json(request: &SlamRequest) -> Value {
    use SlamRequestKind::{
        ClearClosures, ListClosures, LoadSession, Pause, Relocalize, Reset, Resume, SaveMap, SaveSession,
        SetMode, SetPose, State, UndoClosure,
    };
    let Some(kind) = SlamRequestKind::from_code(request.kind) else {
        return json!({ "sender": request.sender.to_string(), "request": request.kind });
    };
    let mut about = json!({ "sender": request.sender.to_string(), "request": name_of(kind) });
    let mode = || SlamMode::from_code(request.mode).map(SlamMode::name);
    match kind {
        SaveMap | SaveSession => about["file"] = json!(request.text.as_str()),
        LoadSession => {
            (about["file"], about["mode"]) = (json!(request.text.as_str()), json!(mode()));
        }
        SetPose => {
            let pose = request.pose;
            about["pose"] = json!([pose.x_m, pose.y_m, pose.yaw_rad]);
            (about["sigma_m"], about["sigma_rad"]) = (json!(request.sigma_m), json!(request.sigma_rad));
        }
        UndoClosure | ListClosures => about["closure"] = json!(request.number),
        SetMode => about["mode"] = json!(mode()),
        State | Pause | Resume | Reset | ClearClosures | Relocalize => {}
    }
    about
}

/// Returns the name of a request as the command line has it.
fn name_of(kind: SlamRequestKind) -> &'static str {
    match kind {
        SlamRequestKind::State => "state",
        SlamRequestKind::Pause => "pause",
        SlamRequestKind::Resume => "resume",
        SlamRequestKind::Reset => "reset",
        SlamRequestKind::SaveMap => "map",
        SlamRequestKind::SaveSession => "save",
        SlamRequestKind::LoadSession => "load",
        SlamRequestKind::SetPose => "pose",
        SlamRequestKind::ListClosures => "closures",
        SlamRequestKind::UndoClosure => "undo",
        SlamRequestKind::ClearClosures => "clear",
        SlamRequestKind::Relocalize => "relocalize",
        SlamRequestKind::SetMode => "mode",
    }
}

/// Returns a command about a merge edge as JSON: action, and the numbers of the two robots.
pub fn edge_command_json(command: &EdgeCommand) -> Value {
    let action = EdgeAction::from_code(command.action).map(|action| format!("{action:?}").to_lowercase());
    let pairs = (1..ROBOTS_MAX).flat_map(|high| (0..high).map(move |low| (low, high)));
    let edge_of = |(low, high): (usize, usize)| {
        let pair = [RobotId::new(low + 1)?, RobotId::new(high + 1)?];
        let command = EdgeCommand::for_pair(EdgeAction::Pin, pair[0], pair[1])?;
        Some((command.edge, pair.map(RobotId::number)))
    };
    let robots = pairs.filter_map(edge_of).find(|(edge, _)| *edge == command.edge).map(|(_, pair)| pair);
    json!({ "sender": command.sender.to_string(), "action": action, "robots": robots })
}

/// Returns an action of an operator as JSON; `robot` is `null` for all, or none in particular.
pub fn operator_event_json(event: &OperatorEvent) -> Value {
    let robot = RobotId::new(event.robot as usize).map(|robot| robot.to_string());
    let action = event.action().map(OperatorAction::name);
    json!({ "sender": event.sender.to_string(), "action": action, "robot": robot })
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{CommandSource, NavigationAction, Pose2, Text};

    #[test]
    fn commands_name_their_sender_and_the_values_that_they_use() {
        let sender = CommandSource::LAPTOP;
        let save = SlamRequest {
            sender,
            kind: SlamRequestKind::SaveMap as u32,
            text: Text::new("map").unwrap(),
            ..SlamRequest::default()
        };
        assert_eq!(slam_request_json(&save), json!({ "sender": "laptop", "request": "map", "file": "map" }));
        let pose = SlamRequest {
            kind: SlamRequestKind::SetPose as u32,
            pose: Pose2::new(1.0, 2.0, 0.5),
            sigma_m: 0.1,
            sigma_rad: 0.2,
            ..save
        };
        assert_eq!(slam_request_json(&pose)["pose"], json!([1.0, 2.0, 0.5]));
        assert_eq!(slam_request_json(&SlamRequest { kind: 99, ..save })["request"], json!(99));
        let pin = EdgeCommand { sender: CommandSource::ROS2, ..EdgeCommand::parse("undo 7 3").unwrap() };
        assert_eq!(edge_command_json(&pin), json!({ "sender": "ros2", "action": "undo", "robots": [3, 7] }));
        let unknown = edge_command_json(&EdgeCommand { edge: u32::MAX, ..pin });
        assert_eq!(unknown["robots"], json!(null));
        let stop =
            OperatorEvent::new(CommandSource::client(([127, 0, 0, 1], 5).into()), OperatorAction::Stop, None);
        assert_eq!(
            operator_event_json(&stop),
            json!({ "sender": "client 127.0.0.1:5", "action": "emergency_stop", "robot": null })
        );
        let cancel = NavigationCommand { sender, ..NavigationCommand::new(1, NavigationAction::Cancel) };
        assert_eq!(navigation_command_json(&cancel)["sender"], json!("laptop"));
    }
}
