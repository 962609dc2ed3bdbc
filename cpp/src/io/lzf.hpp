#pragma once

#include <cstdint>
#include <span>
#include <vector>

/// @file
/// LZF, the compression of PCD files: runs of up to 32 bytes as they are, and copies of up to 264
/// bytes from at most 8 KiB back. The format is that of Marc Lehmann's liblzf.
namespace manip3d {

/// Three bytes stand for 264 at most.
constexpr std::int64_t kLzfMostExpansion = 88;

/// @param offset  where `packed` begins in its file, for messages
/// @throws FormatError  with the byte: it does not expand to exactly `size` bytes.
std::vector<char> lzf_decompress(std::span<const char> packed, std::size_t size,
                                 std::int64_t offset);

/// Deterministic; the result is at most 1/32 and one byte longer than the input.
std::vector<char> lzf_compress(std::span<const char> data);

}  // namespace manip3d
