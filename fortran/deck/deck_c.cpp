// Decks for rk_deck.f90: one flat list of entries, in the order of the schema.
//
// Entry kinds: 0 table, 1 text, 2 texts (a line each), 3 number, 4 integer, 5 boolean (0 or 1),
// 6 numbers, 7 integers, 8 array of tables (with their number; they follow). All pointers live
// until rk_deck_close.
#include "deck.h"

#include <algorithm>
#include <iomanip>
#include <numeric>
#include <sstream>

namespace {

struct Entry {
   std::string key, where, address, text;
   int kind = 0;
   std::vector<double> numbers;
};

struct Flat {
   rk::Deck deck;
   std::vector<Entry> entries;
   std::vector<int> sorted; // entries by their keys
};

// Expressions among numbers
bool has_text(const rk::Value &value) {
   return std::any_of(value.items.begin(), value.items.end(), [](const rk::Value &item) {
      return item.kind == rk::Value::Kind::text;
   });
}

// All digits, which Value::plain cuts for messages
std::string exactly(double number) {
   std::ostringstream text;
   text << std::setprecision(17) << number;
   return text.str();
}

int kind_of(const rk::KeySpec &spec, const rk::Value &value) {
   switch (spec.type) {
   case rk::Type::text:
      return value.is_number() ? 3 : 1;
   case rk::Type::texts:
      return 2;
   case rk::Type::number:
      return value.is_number() ? 3 : 1;
   case rk::Type::integer:
      return 4;
   case rk::Type::boolean:
      return 5;
   case rk::Type::numbers:
      return has_text(value) ? 2 : 6;
   default:
      return 7;
   }
}

Entry flatten(const rk::Value &value) {
   Entry entry;
   if (value.is_number())
      entry.numbers = {value.number()};
   if (value.kind == rk::Value::Kind::boolean)
      entry.numbers = {value.boolean ? 1.0 : 0.0};
   if (value.kind == rk::Value::Kind::text)
      entry.text = value.text;
   const bool as_text = has_text(value);
   for (const rk::Value &item : value.items) {
      if (item.is_number() && as_text)
         entry.text += exactly(item.number()) + "\n";
      else if (item.is_number())
         entry.numbers.push_back(item.number());
      else
         entry.text += item.text + "\n";
   }
   return entry;
}

void add_section(Flat &flat, const rk::Section &section) {
   std::string prefix = section.spec->name;
   if (section.spec->many)
      prefix += "." + std::to_string(section.index);
   if (!prefix.empty()) {
      Entry table;
      table.key = prefix;
      table.where = flat.deck.where(section.origin);
      table.address = flat.deck.address(section);
      flat.entries.push_back(table);
   }
   for (const rk::KeySpec &spec : section.spec->keys) {
      const rk::Value *value = section.find(spec.name);
      if (!value)
         continue;
      Entry entry = flatten(*value);
      entry.key = prefix.empty() ? spec.name : prefix + "." + spec.name;
      // empty: nobody wrote it
      entry.where = value->by_default ? "" : flat.deck.where(value->origin);
      entry.address = flat.deck.address(section, spec.name);
      entry.kind = kind_of(spec, *value);
      flat.entries.push_back(entry);
   }
}

Flat *open(rk::Deck deck) {
   Flat *flat = new Flat{std::move(deck), {}, {}};
   if (flat->deck.status != rk::Status::good)
      return flat;
   for (const rk::TableSpec &spec : rk::schema()) {
      const std::vector<rk::Section *> sections = flat->deck.entries(spec.name);
      if (spec.many) {
         Entry list;
         list.key = spec.name;
         list.where = flat->deck.where(sections.empty() ? rk::Origin{} : sections.front()->origin);
         list.kind = 8;
         list.numbers = {static_cast<double>(sections.size())};
         flat->entries.push_back(list);
      }
      for (const rk::Section *section : sections)
         add_section(*flat, *section);
   }
   flat->sorted.resize(flat->entries.size());
   std::iota(flat->sorted.begin(), flat->sorted.end(), 0);
   std::sort(flat->sorted.begin(), flat->sorted.end(), [flat](int one, int other) {
      return flat->entries[static_cast<std::size_t>(one)].key <
             flat->entries[static_cast<std::size_t>(other)].key;
   });
   return flat;
}

// Overrides come a line each
std::vector<std::string> lines(const char *text) {
   std::vector<std::string> found;
   std::istringstream stream(text);
   for (std::string line; std::getline(stream, line);) {
      if (!line.empty())
         found.push_back(line);
   }
   return found;
}

} // namespace

extern "C" {

void *rk_deck_read(const char *path, const char *overrides) {
   return open(rk::Deck::read(path, lines(overrides)));
}

void *rk_deck_parse(const char *text, const char *name, const char *overrides) {
   return open(rk::Deck(name, text, lines(overrides)));
}

void *rk_deck_defaults(const char *table, const char *key, const char *value) {
   return open(rk::Deck::defaults(table, key, value));
}

int rk_deck_status(const void *handle) {
   return static_cast<int>(static_cast<const Flat *>(handle)->deck.status);
}

// 1 message, 2 name, 3 text, 4 sha256, 5 folder
const char *rk_deck_property(const void *handle, int which) {
   const rk::Deck &deck = static_cast<const Flat *>(handle)->deck;
   switch (which) {
   case 1:
      return deck.message.c_str();
   case 2:
      return deck.name.c_str();
   case 3:
      return deck.text.c_str();
   case 4:
      return deck.sha256.c_str();
   default:
      return deck.folder.c_str();
   }
}

int rk_deck_size(const void *handle) {
   return static_cast<int>(static_cast<const Flat *>(handle)->entries.size());
}

// Entry number `index` (from 0); returns its kind. `sorted`: the entry that has this place by its key
int rk_deck_entry(const void *handle, int index, const char **key, const char **where,
                  const char **address, const char **text, int *count, const double **numbers,
                  int *sorted) {
   const Flat &flat = *static_cast<const Flat *>(handle);
   const Entry &entry = flat.entries[static_cast<std::size_t>(index)];
   *sorted = flat.sorted[static_cast<std::size_t>(index)];
   *key = entry.key.c_str();
   *where = entry.where.c_str();
   *address = entry.address.c_str();
   *text = entry.text.c_str();
   *count = static_cast<int>(entry.numbers.size());
   *numbers = entry.numbers.data();
   return entry.kind;
}

// The full name of a key as an override would take it; "" where the status and message say why not
const char *rk_deck_resolve(void *handle, const char *key) {
   thread_local std::string found;
   found = static_cast<Flat *>(handle)->deck.resolve(key);
   return found.c_str();
}

void rk_deck_close(void *handle) {
   delete static_cast<Flat *>(handle);
}

// Tables that a command needs, a line each, followed by the table that may stand in its place
const char *rk_deck_needed(const char *command) {
   thread_local std::string tables;
   tables.clear();
   for (const rk::TableSpec &spec : rk::schema()) {
      for (const std::string &user : spec.needed_by) {
         if (user != command)
            continue;
         tables += spec.name;
         if (!spec.not_beside.empty())
            tables += " " + spec.not_beside;
         tables += "\n";
      }
   }
   return tables.c_str();
}

} // extern "C"
