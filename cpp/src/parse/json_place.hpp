#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>

#include "manip3d/error.hpp"

namespace manip3d {

/// A JSON value with its place for error messages: an RFC 6901 pointer such as /accessors/3/count,
/// and the byte at which the JSON text starts.
class JsonPlace {
 public:
  using Json = nlohmann::json;

  JsonPlace(const Json& value, std::string pointer, std::int64_t text_offset)
      : value_(&value), pointer_(std::move(pointer)), text_offset_(text_offset) {}

  [[noreturn]] void fail(const std::string& reason) const {
    throw FormatError::at_byte(text_offset_, pointer_ + ": " + reason);
  }

  [[nodiscard]] std::optional<JsonPlace> find(const char* key) const {
    if (!value_->is_object()) fail(std::string("expected an object, got ") + value_->type_name());
    const auto member = value_->find(key);
    // Some exporters write null where they have nothing.
    if (member == value_->end() || member->is_null()) return std::nullopt;
    return JsonPlace(*member, pointer_ + "/" + key, text_offset_);
  }

  [[nodiscard]] JsonPlace member(const char* key) const {
    auto found = find(key);
    if (!found) fail(std::string("expected a member \"") + key + "\"");
    return *std::move(found);
  }

  [[nodiscard]] bool is_object() const { return value_->is_object(); }
  [[nodiscard]] bool is_text() const { return value_->is_string(); }
  [[nodiscard]] bool has(const char* key) const { return find(key).has_value(); }

  /// Number of elements of an array.
  [[nodiscard]] std::int64_t size() const {
    if (!value_->is_array()) fail(std::string("expected an array, got ") + value_->type_name());
    return static_cast<std::int64_t>(value_->size());
  }

  [[nodiscard]] JsonPlace item(std::int64_t index) const {
    return {(*value_)[index], pointer_ + "/" + std::to_string(index), text_offset_};
  }

  /// A whole number in [lowest, highest]. 3.0 is accepted for 3, because some JSON writers write
  /// it.
  [[nodiscard]] std::int64_t integer(std::int64_t lowest, std::int64_t highest) const {
    const auto refuse = [&] {
      fail("expected a whole number in [" + std::to_string(lowest) + ", " +
           std::to_string(highest) + "], got " + shown());
    };
    constexpr double kExact = 9007199254740992.0;  // 2^53
    if (value_->is_number_unsigned() &&
        value_->get<std::uint64_t>() >
            static_cast<std::uint64_t>(std::numeric_limits<std::int64_t>::max())) {
      refuse();
    }
    if (value_->is_number_float()) {
      const double number = value_->get<double>();
      if (!(std::abs(number) <= kExact) || number != std::floor(number)) refuse();
    } else if (!value_->is_number_integer()) {
      refuse();
    }
    const auto number = value_->get<std::int64_t>();
    if (number < lowest || number > highest) refuse();
    return number;
  }

  [[nodiscard]] double number() const {
    if (!value_->is_number()) fail("expected a number, got " + shown());
    return value_->get<double>();
  }

  [[nodiscard]] bool boolean() const {
    if (!value_->is_boolean()) fail("expected true or false, got " + shown());
    return value_->get<bool>();
  }

  [[nodiscard]] const std::string& text() const {
    if (!value_->is_string()) fail("expected a string, got " + shown());
    return value_->get_ref<const std::string&>();
  }

  [[nodiscard]] const std::string& pointer() const { return pointer_; }
  [[nodiscard]] const Json& value() const { return *value_; }

 private:
  [[nodiscard]] std::string shown() const {
    return value_->is_structured() ? value_->type_name() : value_->dump().substr(0, 40);
  }

  const Json* value_;
  std::string pointer_;
  std::int64_t text_offset_;
};

}  // namespace manip3d
