// The fleet from C++, by Zenoh alone: an order that is asked again, a lease, a stream of setpoints, a refusal.
//
// With zenoh-cpp on zenoh-c (Eclipse's Debian packages libzenohc-dev and libzenohcpp-dev) or on zenoh-pico:
//
//   g++ -std=c++17 -DZENOHCXX_ZENOHC -o fly ground/examples/fly_zenoh.cpp -lzenohc
//   g++ -std=c++17 -DZENOHCXX_ZENOHPICO -DZENOH_LINUX -o fly ground/examples/fly_zenoh.cpp -lzenohpico
//   zmav sim --up                        # in another terminal
//   ./fly                                # or with a vehicle, its fleet and a router: quad1 demo tcp/127.0.0.1:7447

#include <chrono>
#include <cstdint>
#include <iostream>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <variant>

#include <nlohmann/json.hpp>
#include <zenoh.hxx>

using nlohmann::json;
using namespace std::chrono_literals;

/// The vehicle's own words: `code` for programs, the message for people.
struct Refused : std::runtime_error {
    explicit Refused(const json& body)
        : std::runtime_error(body.value("message", body.dump())), code(body.value("code", "")) {}
    std::string code;
};

/// UTC seconds.
double now() { return std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count(); }

/// Digits that no other program of the vehicle's last minutes has taken.
std::string unique() {
    std::random_device random;
    return std::to_string(std::uint64_t{random()} << 32 | random());
}

zenoh::Session open(const std::string& router) {
    auto config = zenoh::Config::create_default();
#ifdef ZENOHCXX_ZENOHC
    config.insert_json5("mode", "\"client\"");
    config.insert_json5("connect/endpoints", json{router}.dump());
    config.insert_json5("scouting/multicast/enabled", "false");
#else
    config.insert(Z_CONFIG_MODE_KEY, Z_CONFIG_MODE_CLIENT);
    config.insert(Z_CONFIG_CONNECT_KEY, router.c_str());
    config.insert(Z_CONFIG_MULTICAST_SCOUTING_KEY, "false");
#endif
    return zenoh::Session::open(std::move(config));
}

class Vehicle {
public:
    Vehicle(zenoh::Session& session, const std::string& fleet, const std::string& name)
        : session_(session), base_("zmav/" + fleet + "/" + name + "/") {}

    std::string key(const std::string& what) const { return base_ + what; }

    /// The first answer to a question; nothing where none comes in time. Throws Refused.
    std::optional<json> ask(const std::string& what, const json& payload) {
        zenoh::Session::GetOptions options;
        options.target = zenoh::QueryTarget::Z_QUERY_TARGET_ALL;
        options.consolidation = zenoh::QueryConsolidation(zenoh::ConsolidationMode::Z_CONSOLIDATION_MODE_NONE);
        options.payload = payload.dump();
        options.timeout_ms = 5000;
        auto replies = session_.get(key(what), "", zenoh::channels::FifoChannel(16), std::move(options));
        for (;;) {
            auto received = replies.recv();
            if (!std::holds_alternative<zenoh::Reply>(received)) return std::nullopt;
            const auto& reply = std::get<zenoh::Reply>(received);
            const auto& bytes = reply.is_ok() ? reply.get_ok().get_payload() : reply.get_err().get_payload();
            json body = json::parse(bytes.as_string(), nullptr, false);
            if (body.is_discarded()) continue;  // Zenoh's own words: nobody answered in time
            if (!reply.is_ok()) throw Refused(body);
            return body;
        }
    }

    /// An order, asked again with its id until it has ended: an answer may be lost, and nothing is done twice.
    json order(const std::string& verb, json arguments = json::object()) {
        arguments["id"] = "cpp-" + unique();
        arguments["wait"] = 1;
        for (int silent = 0;;) {
            const auto outcome = ask("do/" + verb, arguments);
            if (!outcome) {
                if (++silent == 4) throw std::runtime_error(verb + ": nobody answers " + std::to_string(silent) + " times");
                std::cout << verb << ": no answer, asked again" << std::endl;
            } else if (outcome->value("status", "") == "done") {
                return outcome->value("result", json::object());
            } else {
                silent = 0;
                std::cout << verb << ": not done yet " << outcome->value("result", json()) << std::endl;
            }
        }
    }

private:
    zenoh::Session& session_;
    std::string base_;
};

/// Leads the vehicle to a point by so many setpoints, 20 a second, under a lease.
void lead(zenoh::Session& session, Vehicle& vehicle, int count) {
    // While this token is there the lease is ours: the vehicle holds at once where this program dies.
    const std::string holder = "cpp", instance = unique();
    auto alive = session.liveliness_declare_token(vehicle.key("holder/" + holder + "/" + instance));
    const json granted = vehicle.order("lease", {{"holder", holder}, {"instance", instance}});
    zenoh::Session::PublisherOptions realtime;
    realtime.priority = zenoh::Priority::Z_PRIORITY_REAL_TIME;
    realtime.congestion_control = zenoh::CongestionControl::Z_CONGESTION_CONTROL_DROP;
    auto points = session.declare_publisher(vehicle.key("setpoint/" + holder), std::move(realtime));
    for (int seq = 1; seq <= count; seq++) {
        const json point = {{"lease", granted["lease"]}, {"seq", seq}, {"deadline", now() + 0.5}, {"pos", {6, 2, -8}}};
        points.put(point.dump());
        std::this_thread::sleep_for(50ms);
    }
    if (const auto state = vehicle.ask("state", json::object()))
        std::cout << "at " << (*state)["local"] << " moved by " << (*state)["lease"]["holder"] << std::endl;
    vehicle.order("release", {{"lease", granted["lease"]}});
    std::move(alive).undeclare();
}

void fly(const std::string& name, const std::string& fleet, const std::string& router) {
    auto session = open(router);
    auto states = session.get("zmav/" + fleet + "/*/state", "", zenoh::channels::FifoChannel(16));
    for (auto each = states.recv(); std::holds_alternative<zenoh::Reply>(each); each = states.recv()) {
        if (!std::get<zenoh::Reply>(each).is_ok()) continue;
        const json state = json::parse(std::get<zenoh::Reply>(each).get_ok().get_payload().as_string());
        std::cout << state["name"] << ": " << state["kind"] << " " << state["mode"] << std::endl;
    }
    Vehicle vehicle(session, fleet, name);
    vehicle.order("arm");
    vehicle.order("takeoff", {{"alt_rel", 8}});
    try {
        vehicle.order("goto", {{"pos", {0, 0, -90000}}});
    } catch (const Refused& refusal) {
        std::cout << "refused (" << refusal.code << "): " << refusal.what() << ": it flies on, nothing has changed\n";
    }
    lead(session, vehicle, 80);
    vehicle.order("land");
    std::cout << "landed" << std::endl;
}

int main(int count, char** given) {
    const auto argument = [&](int index, const char* otherwise) { return count > index ? given[index] : otherwise; };
    try {
        fly(argument(1, "quad1"), argument(2, "demo"), argument(3, "tcp/127.0.0.1:7447"));
    } catch (const Refused& refusal) {
        std::cerr << "refused (" << refusal.code << "): " << refusal.what() << std::endl;
        return 1;
    } catch (const std::exception& error) {
        std::cerr << error.what() << std::endl;
        return 1;
    }
}
