#include "authenticate/watermark_suite.hpp"

#include <numeric>
#include <utility>

#include "authenticate/little_endian.hpp"
#include "manip3d/error.hpp"

namespace manip3d {
namespace {

constexpr int kNumKeys = 5;
constexpr std::size_t kStack = 4096;  // bytes that libsodium's functions may leave on the stack

}  // namespace

TagHash::TagHash(std::span<const std::uint8_t> key) {
  if (sodium_init() < 0) throw Error("libsodium cannot be started");
  crypto_generichash_init(&state_, key.empty() ? nullptr : key.data(), key.size(), 32);
}

TagHash::~TagHash() { sodium_memzero(&state_, sizeof state_); }

void TagHash::update(std::span<const std::uint8_t> bytes) {
  crypto_generichash_update(&state_, bytes.data(), bytes.size());
}

WatermarkTag TagHash::finish() {
  WatermarkTag tag;
  crypto_generichash_final(&state_, tag.data(), tag.size());
  return tag;
}

SessionKeys::SessionKeys(const SecretBytes& root, const WatermarkId& sensor,
                         const WatermarkId& session)
    : sensor_(sensor), session_(session), keys_(32 * kNumKeys) {
  SecretBytes session_key(crypto_kdf_KEYBYTES);
  {
    TagHash hash(root.span());
    hash.update("m3d/session/v1");
    hash.update(sensor);
    hash.update(session);
    WatermarkTag derived = hash.finish();
    std::copy(derived.begin(), derived.end(), session_key.data());
    sodium_memzero(derived.data(), derived.size());
  }
  for (std::uint64_t number = 0; number < kNumKeys; ++number) {
    crypto_kdf_derive_from_key(keys_.data() + 32 * number, 32, number + 1, "m3d-wm01",
                               session_key.data());
  }
  sodium_stackzero(kStack);
}

bool equal_in_constant_time(std::span<const std::uint8_t> a, std::span<const std::uint8_t> b) {
  return a.size() == b.size() && sodium_memcmp(a.data(), b.data(), a.size()) == 0;
}

void carrier_bits(const SessionKeys& keys, const WatermarkTag& tag, std::size_t count,
                  std::vector<std::uint8_t>& stream) {
  TagHash hash(keys.bits());
  hash.update(tag);
  WatermarkTag key = hash.finish();
  constexpr std::array<std::uint8_t, crypto_stream_chacha20_NONCEBYTES> kNonce{};
  stream.resize((count + 7) / 8);
  crypto_stream_chacha20(stream.data(), stream.size(), kNonce.data(), key.data());
  sodium_memzero(key.data(), key.size());
}

std::vector<std::uint32_t> keyed_permutation(std::span<const std::uint8_t> key,
                                             const std::array<std::uint8_t, 12>& nonce,
                                             std::uint32_t size) {
  std::vector<std::uint32_t> order(size);
  std::iota(order.begin(), order.end(), 0U);
  std::vector<std::uint8_t> stream(4096);
  std::size_t used = stream.size();
  std::uint32_t block = 0;
  const auto next = [&]() -> std::uint32_t {
    if (used == stream.size()) {
      std::fill(stream.begin(), stream.end(), std::uint8_t{0});
      crypto_stream_chacha20_ietf_xor_ic(stream.data(), stream.data(), stream.size(), nonce.data(),
                                         block, key.data());
      block += static_cast<std::uint32_t>(stream.size() / 64);
      used = 0;
    }
    used += 4;
    return load<std::uint32_t>(stream.data() + used - 4);
  };
  for (std::uint32_t left = size; left > 1; --left) {
    std::uint32_t drawn = next();
    // Rejects draws below 2^32 mod left, which would be biased. This limit is less than `left`, so
    // that the division is rare.
    while (drawn < left && drawn < (0U - left) % left) drawn = next();
    std::swap(order[left - 1], order[drawn % left]);
  }
  return order;
}

}  // namespace manip3d
