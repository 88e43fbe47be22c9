// The fleet from C++, over HTTP: an order that is asked again, a lease, a stream of setpoints, a refusal.
//
//   sudo apt install g++ libcurl4-openssl-dev nlohmann-json3-dev
//   g++ -std=c++17 -Wall -o fly ground/examples/fly.cpp -lcurl
//   zmav sim --up                        # in another terminal, and 'zmav http' in a third
//   ./fly                                # or with a vehicle and the gateway: quad1 http://127.0.0.1:8088

#include <chrono>
#include <cstdint>
#include <iostream>
#include <memory>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>

#include <curl/curl.h>
#include <nlohmann/json.hpp>

using nlohmann::json;
using namespace std::chrono_literals;

/// What went wrong on the vehicle or at the gateway: `kind` for programs, the message for people.
struct Refused : std::runtime_error {
    explicit Refused(const json& error)
        : std::runtime_error(error.value("text", error.dump())), kind(error.value("kind", "")) {}
    std::string kind;
};

/// The gateway: one connection, which is kept from request to request.
class Gateway {
public:
    explicit Gateway(std::string address) : address_(std::move(address)), curl_(curl_easy_init(), curl_easy_cleanup) {
        if (!curl_) throw std::runtime_error("libcurl does not start");
    }

    /// The answer's text; a POST where there is a body. Nothing where no answer came in 10 s: it may be lost on the way.
    std::optional<std::string> text(const std::string& path, const json* body = nullptr) {
        CURL* curl = curl_.get();
        curl_easy_reset(curl);
        std::string answer, sent = body ? body->dump() : "", url = address_ + path;
        const std::unique_ptr<curl_slist, decltype(&curl_slist_free_all)> headers(
            curl_slist_append(nullptr, "Content-Type: application/json"), curl_slist_free_all);
        curl_easy_setopt(curl, CURLOPT_URL, url.c_str());
        curl_easy_setopt(curl, CURLOPT_TIMEOUT_MS, 10'000L);
        curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L);
        curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, take);
        curl_easy_setopt(curl, CURLOPT_WRITEDATA, &answer);
        if (body) {
            curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers.get());
            curl_easy_setopt(curl, CURLOPT_POSTFIELDSIZE, static_cast<long>(sent.size()));
            curl_easy_setopt(curl, CURLOPT_POSTFIELDS, sent.c_str());
        }
        if (curl_easy_perform(curl) != CURLE_OK) return std::nullopt;
        return answer;
    }

    /// The answer as JSON; throws Refused where it is an error.
    std::optional<json> ask(const std::string& path, const json* body = nullptr) {
        const auto answer = text(path, body);
        if (!answer) return std::nullopt;
        json value = json::parse(*answer);
        if (value.is_object() && value.contains("error")) throw Refused(value["error"]);
        return value;
    }

private:
    static std::size_t take(char* bytes, std::size_t size, std::size_t count, void* answer) {
        static_cast<std::string*>(answer)->append(bytes, size * count);
        return size * count;
    }

    std::string address_;
    std::unique_ptr<CURL, decltype(&curl_easy_cleanup)> curl_;
};

/// An order, asked again with its id until it has ended: an answer may be lost, and nothing is done twice.
json order(Gateway& gateway, const std::string& vehicle, const std::string& verb, json arguments = json::object()) {
    std::random_device random;
    arguments["id"] = "cpp-" + std::to_string(std::uint64_t{random()} << 32 | random());
    arguments["wait"] = 1;
    for (int silent = 0;;) {
        const auto outcome = gateway.ask("/do/" + vehicle + "/" + verb, &arguments);
        if (!outcome) {
            if (++silent == 4) throw std::runtime_error(verb + ": nobody answers " + std::to_string(silent) + " times");
            std::cout << verb << ": no answer, asked again" << std::endl;
            std::this_thread::sleep_for(1s);
        } else if (outcome->value("status", "") == "done") {
            return outcome->value("result", json::object());
        } else {
            silent = 0;
            std::cout << verb << ": not done yet " << outcome->value("result", json()) << std::endl;
        }
    }
}

void fly(Gateway& gateway, const std::string& vehicle) {
    const auto there = gateway.text("/vehicles");
    if (!there) throw std::runtime_error("nobody answers there: is 'zmav http' running?");
    std::cout << "who is there:\n" << *there;
    order(gateway, vehicle, "arm");
    order(gateway, vehicle, "takeoff", {{"alt_rel", 8}});
    try {
        order(gateway, vehicle, "goto", {{"pos", {0, 0, -90000}}});
    } catch (const Refused& refusal) {
        std::cout << "refused (" << refusal.kind << "): " << refusal.what() << ": it flies on, nothing has changed\n";
    }

    // The gateway takes the lease for its caller, puts the point five times a second for the second it is valid, and
    // gives the lease back 1.5 s after the last call: where this program dies, the vehicle holds.
    const json point = {{"pos", {6, 2, -8}}};
    std::string lease;
    for (int i = 0; i < 40; i++) {
        // A point that is lost is replaced by the next one: only a refusal ends the stream.
        if (const auto answer = gateway.ask("/setpoint/" + vehicle + "?as=cpp", &point)) lease = answer->value("lease", "");
        std::this_thread::sleep_for(100ms);
    }
    if (const auto found = gateway.ask("/keys/" + vehicle)) {
        const json& state = found->at(0).at("value");
        std::cout << "at " << state["local"] << " moved by " << state["lease"]["holder"] << " under " << lease << std::endl;
    }
    gateway.ask("/release/" + vehicle + "?as=cpp");
    order(gateway, vehicle, "land");
    std::cout << "landed" << std::endl;
}

int main(int count, char** given) {
    curl_global_init(CURL_GLOBAL_DEFAULT);
    try {
        Gateway gateway(count > 2 ? given[2] : "http://127.0.0.1:8088");
        fly(gateway, count > 1 ? given[1] : "quad1");
    } catch (const Refused& refusal) {
        std::cerr << "refused (" << refusal.kind << "): " << refusal.what() << std::endl;
        return 1;
    } catch (const std::exception& error) {
        std::cerr << error.what() << std::endl;
        return 1;
    }
}
