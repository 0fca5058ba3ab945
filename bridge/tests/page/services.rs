//! Services of the fleet and of clients at browsers: they are offered with their types, answered, and fail as failures.

use crate::Served;
use crate::browser::{Browser, Response, WAIT_MAX};
use bridge::command::{Registration, name};
use bridge::frame::RosTcpFrame;
use bridge::{Bridge, BridgeConfig, ClientId, Permission};
use msg::{Monotonic, RobotId, SlamOutcome, SlamRequest, SlamRequestKind, SlamResponse};
use std::sync::mpsc::{Receiver, channel};

const ROBOT: RobotId = RobotId::new(1).unwrap();
/// An empty request in CDR.
const EMPTY: &[u8] = &[0, 1, 0, 0, 0];

/// Connects a browser that knows the fleet's services.
fn connect(served: &Served) -> Browser {
    let mut browser = Browser::connect(served.page);
    browser.read_until(|browser| browser.services.contains_key("/robot1/relocalize"));
    browser
}

fn number_of(browser: &Browser, service: &str) -> u32 {
    browser.services[service].0.try_into().unwrap()
}

/// Returns the requests that SLAM gets.
fn slam_requests(served: &Served) -> Receiver<SlamRequest> {
    let (send, requests) = channel();
    served
        .with(move |bridge| bridge.on_slam_request(move |_, request| send.send(request).unwrap_or_default()));
    requests
}

fn answer(served: &Served, request: &SlamRequest, outcome: SlamOutcome, text: &'static str) {
    let id = request.id;
    served.with(move |bridge| {
        let text = msg::Text::new(text).unwrap();
        let answer = SlamResponse { id, outcome: outcome as u32, text, ..SlamResponse::default() };
        bridge.receive_slam_response(ROBOT, &answer, true);
    });
}

/// Connects a client in this process that offers a service.
fn offer(bridge: &Bridge, service: &str) -> ClientId {
    let provider = bridge.connect(([127, 0, 0, 1], 5000).into()).unwrap();
    let (topic, message_name) = (service.to_owned(), "std_srvs/Trigger".to_owned());
    let body = Registration { topic, message_name, ..Registration::default() };
    let payload = serde_json::to_vec(&body).unwrap();
    let frame = RosTcpFrame { name: name::UNITY_SERVICE.as_bytes(), payload: &payload };
    bridge.receive(provider, frame, Monotonic(0));
    provider
}

#[test]
fn slams_services_are_offered_with_their_types_and_answered() {
    let served = Served::start(BridgeConfig::default());
    let requests = slam_requests(&served);
    let mut browser = connect(&served);
    assert_eq!(browser.services["/robot1/relocalize"].1, "std_srvs/srv/Trigger");
    assert_eq!(browser.services["/robot2/slam_toolbox/save_map"].1, "slam_toolbox/srv/SaveMap");
    let service = number_of(&browser, "/robot1/relocalize");
    for call in [7, 8] {
        browser.call(service, call, "cdr", EMPTY);
        let request = requests.recv_timeout(WAIT_MAX).unwrap();
        assert_eq!(request.kind, SlamRequestKind::Relocalize as u32);
        answer(&served, &request, SlamOutcome::Done, "looking");
    }
    browser.read_until(|browser| browser.responses.len() == 2);
    let payload = [&[0, 1, 0, 0, 1, 0, 0, 0, 8, 0, 0, 0][..], b"looking\0"].concat();
    let response = |call| Response { service, call, payload: payload.clone() };
    assert_eq!(browser.responses, [response(7), response(8)]);
    assert!(browser.failures.is_empty() && browser.statuses.is_empty(), "{:?}", browser.statuses);
}

#[test]
fn a_call_that_fails_is_said_to_fail_and_gets_no_response() {
    let served = Served::start(BridgeConfig::default());
    let requests = slam_requests(&served);
    let mut browser = connect(&served);
    let service = number_of(&browser, "/robot1/reset");
    browser.call(service, 1, "cdr", EMPTY);
    answer(&served, &requests.recv_timeout(WAIT_MAX).unwrap(), SlamOutcome::Refused, "not now");
    browser.call(service, 2, "json", b"{}");
    browser.call(service + 1000, 3, "cdr", EMPTY);
    browser.call(service, 4, "cdr", b"\x00");
    // One whose response has no fields, which reads as success.
    browser.call(number_of(&browser, "/robot1/slam_toolbox/deserialize_map"), 5, "cdr", EMPTY);
    browser.read_until(|browser| browser.failures.len() == 5);
    browser.failures.sort();
    for ((call, text), (wanted, part)) in
        browser.failures.iter().zip([(1, "not now"), (2, "takes 'cdr'"), (3, "no service"), (4, ""), (5, "")])
    {
        assert!(*call == wanted && text.contains(part), "{call}: {text}");
    }
    assert_eq!(browser.responses, []);
    assert!(browser.statuses.is_empty(), "the failure is enough: {:?}", browser.statuses);
}

#[test]
fn an_address_without_permission_calls_nothing_of_the_fleet() {
    let config =
        BridgeConfig { trust_loopback: false, drive: Permission::Allowed, ..BridgeConfig::default() };
    let served = Served::start(config);
    let requests = slam_requests(&served);
    let mut browser = connect(&served);
    let service = number_of(&browser, "/robot1/reset");
    browser.call(service, 1, "cdr", EMPTY);
    browser.read_until(|browser| !browser.failures.is_empty());
    assert!(browser.failures[0].1.contains("mr-slam allow 127.0.0.1"), "{:?}", browser.failures);
    assert!(requests.try_recv().is_err());
    served.with(|bridge| bridge.allow([127, 0, 0, 1].into())).unwrap();
    browser.call(service, 2, "cdr", EMPTY);
    assert_eq!(requests.recv_timeout(WAIT_MAX).unwrap().kind, SlamRequestKind::Reset as u32);
}

#[test]
fn a_clients_service_comes_and_goes_and_takes_its_calls_with_it() {
    let served = Served::start(BridgeConfig::default());
    let mut browser = connect(&served);
    let provider = served.with(|bridge| offer(bridge, "/camera/start"));
    browser.read_until(|browser| browser.services.contains_key("/camera/start"));
    browser.call(number_of(&browser, "/camera/start"), 9, "cdr", EMPTY);
    let has_call = move |bridge: &Bridge| {
        let mut bytes = Vec::new();
        bridge.take_outgoing(provider, &mut bytes).unwrap();
        bytes.windows(9).any(|window| window == b"__request")
    };
    let begun = std::time::Instant::now();
    while !served.with(has_call) {
        assert!(begun.elapsed() < WAIT_MAX, "the provider gets the call");
    }
    served.with(move |bridge| bridge.disconnect(provider));
    browser.read_until(|browser| {
        !browser.failures.is_empty() && !browser.services.contains_key("/camera/start")
    });
    assert_eq!(browser.failures[0].0, 9);
    assert_eq!(browser.responses, []);
}
