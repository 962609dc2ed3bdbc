#pragma once

#include <cstdint>
#include <span>
#include <vector>

/// @file
/// LZF, the compression of PCD files: literal runs of up to 32 bytes, and copies of up to 264 bytes
/// from at most 8 KiB back. The format is that of Marc Lehmann's liblzf.
namespace manip3d {

/// Three packed bytes expand to 264 at most.
constexpr std::int64_t kLzfMostExpansion = 88;

/// @param offset  Offset of `packed` in its file, for messages.
/// @throws FormatError  (with the byte) it does not expand to exactly `size` bytes.
std::vector<char> lzf_decompress(std::span<const char> packed, std::size_t size,
                                 std::int64_t offset);

/// Compresses deterministically. The result is at most 1/32 plus one byte longer than the input.
std::vector<char> lzf_compress(std::span<const char> data);

}  // namespace manip3d
