// Reads every record of a log with @mcap/core, its checksums on, and prints what was in it.
import { createRequire } from "node:module";
import { readFileSync } from "node:fs";
import zlib from "node:zlib";
const [file, packages] = process.argv.slice(2);
const { McapIndexedReader, McapStreamReader } = createRequire(packages + "/")("@mcap/core");
const zstd = zlib.zstdDecompressSync ?? createRequire(packages + "/")("fzstd").decompress;
const decompressHandlers = { zstd: (data, size) => zstd(data, new Uint8Array(Number(size))) };
const data = readFileSync(file);
const bytes = new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
const told = { messages: {}, attachments: [], metadata: [], indexed: 0 };
const stream = new McapStreamReader({ decompressHandlers, validateCrcs: true });
stream.append(bytes);
const topics = new Map();
for (let record; (record = stream.nextRecord()); ) {
  if (record.type === "Channel") topics.set(record.id, record.topic);
  if (record.type === "Message") {
    const topic = topics.get(record.channelId);
    told.messages[topic] = (told.messages[topic] ?? 0) + 1;
  }
  if (record.type === "Attachment") told.attachments.push(record.name);
  if (record.type === "Metadata") told.metadata.push(record.name);
}
told.done = stream.done();
const readable = {
  size: async () => BigInt(bytes.length),
  read: async (offset, size) => bytes.slice(Number(offset), Number(offset) + Number(size)),
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
for await (const _ of reader.readMessages({ validateCrcs: true })) told.indexed += 1;
console.log(JSON.stringify(told));
