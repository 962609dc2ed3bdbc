#pragma once

#include <sodium.h>

#include <array>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "manip3d/authenticate/watermark_key.hpp"
#include "manip3d/authenticate/watermark_picture.hpp"

/// @file
/// Suite 1 of the watermark: keyed BLAKE2b-256 for tags, ChaCha20 for bits and permutations.
namespace manip3d {

using WatermarkTag = std::array<std::uint8_t, 32>;

inline std::span<const std::uint8_t> bytes_of(std::string_view text) {
  return {reinterpret_cast<const std::uint8_t*>(text.data()), text.size()};
}

/// BLAKE2b-256, keyed unless `key` is empty. The state is wiped by the destructor.
class TagHash {
 public:
  explicit TagHash(std::span<const std::uint8_t> key = {});
  TagHash(const TagHash&) = delete;
  TagHash& operator=(const TagHash&) = delete;
  ~TagHash();

  void update(std::span<const std::uint8_t> bytes);
  void update(std::string_view text) { update(bytes_of(text)); }
  [[nodiscard]] WatermarkTag finish();

 private:
  crypto_generichash_state state_;
};

/// The keys of one session, derived from the root key.
class SessionKeys {
 public:
  SessionKeys() = default;
  SessionKeys(const SecretBytes& root, const WatermarkId& sensor, const WatermarkId& session);

  [[nodiscard]] bool is_for(const WatermarkId& sensor, const WatermarkId& session) const {
    return keys_.size() != 0 && sensor == sensor_ && session == session_;
  }
  [[nodiscard]] std::span<const std::uint8_t> tile() const { return key(0); }
  [[nodiscard]] std::span<const std::uint8_t> frame() const { return key(1); }
  [[nodiscard]] std::span<const std::uint8_t> bits() const { return key(2); }
  [[nodiscard]] std::span<const std::uint8_t> image() const { return key(4); }
  void close() { keys_ = SecretBytes(); }

 private:
  [[nodiscard]] std::span<const std::uint8_t> key(std::size_t number) const {
    return keys_.span().subspan(32 * number, 32);
  }

  WatermarkId sensor_{}, session_{};
  SecretBytes keys_;  // K_tile, K_frame, K_bits, K_perm, K_image
};

bool equal_in_constant_time(std::span<const std::uint8_t> a, std::span<const std::uint8_t> b);

/// Writes `count` bits of ChaCha20(BLAKE2b(K_bits, tag), nonce 0), the lowest bit of each byte
/// first.
void carrier_bits(const SessionKeys& keys, const WatermarkTag& tag, std::size_t count,
                  std::vector<std::uint8_t>& stream);

/// BLAKE2b(K_image, "m3d-image" | height u32 | width u32 | channels u32 | samples without the
/// carrier bits): the context that a record in a picture binds.
WatermarkTag tag_of_picture(std::span<const std::uint8_t> key, const PictureView& picture);

/// Random permutation of [0, size): Fisher-Yates with rejection sampling of ChaCha20-IETF.
std::vector<std::uint32_t> keyed_permutation(std::span<const std::uint8_t> key,
                                             const std::array<std::uint8_t, 12>& nonce,
                                             std::uint32_t size);

}  // namespace manip3d
