//! Runs a test of the ROS 2 endpoint on one thread, for 60 s at most, with its bridge and a node of others.

use bridge::dds::{DdsEndpoint, DdsQueues};
use bridge::{Bridge, BridgeConfig, process_clock};
use ros2_client::dds::rustdds::DomainParticipantBuilder;
use ros2_client::dds::{Context, Node};
use ros2_client::{NodeName, NodeOptions};
use std::future::Future;
use std::net::Ipv4Addr;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::{LocalSet, spawn_local};

/// No test takes this long unless it hangs.
const WATCHDOG: Duration = Duration::from_secs(60);

/// Runs a test; fails if it hangs.
pub fn run(test: impl Future<Output = ()>) {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    LocalSet::new().block_on(&runtime, async {
        tokio::time::timeout(WATCHDOG, test).await.expect("the test hangs");
    });
}

/// Creates a node in the domain of the configuration, on this machine alone.
pub fn node(config: &BridgeConfig) -> Node {
    let builder =
        DomainParticipantBuilder::new(config.dds.domain()).with_only_networks([Ipv4Addr::LOCALHOST]);
    let context = Context::from_domain_participant(builder.build().unwrap()).unwrap();
    let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
    context.new_node(NodeName::new("/", "other").unwrap(), options).unwrap()
}

/// Serves the endpoint, and passes what it and the bridge have for each other.
pub fn connect(bridge: &Rc<Bridge>, endpoint: Rc<DdsEndpoint>, queues: Arc<DdsQueues>) {
    let (receiver, commands) = (bridge.clone(), queues.clone());
    bridge.on_ros_command(move |command| commands.send_command(command));
    spawn_local(endpoint.serve());
    spawn_local(async move {
        loop {
            receiver.receive_ros(queues.next_event().await, process_clock());
        }
    });
}
